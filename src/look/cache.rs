//! A bounded cache of what is expensive to make, shared by threads.
//!
//! What is wanted by several threads at once is made by one of them; the others wait. Nothing is made
//! while the lock is held. What was not used since it was last passed over goes first (second chance).
//! The bound holds for what the cache keeps; what its users still hold of evicted values is theirs.

// Under test the scheduler is the test's own, which tries many orders of the threads.
#[cfg(test)]
use shuttle::sync::{Condvar, Mutex, MutexGuard};
use std::collections::{HashMap, VecDeque};
use std::sync::{Arc, PoisonError};
#[cfg(not(test))]
use std::sync::{Condvar, Mutex, MutexGuard};

/// What knows how many bytes it takes.
pub trait Weight {
    /// Bytes in memory.
    fn weight(&self) -> u64;
}

/// Values by number, of at most so many bytes in all.
pub struct Cache<V> {
    capacity: u64,
    state: Mutex<State<V>>,
    made: Condvar,
}

struct State<V> {
    places: HashMap<u32, Place<V>>,
    /// Those that are held, the next to be passed over first.
    round: VecDeque<u32>,
    bytes: u64,
}

enum Place<V> {
    /// Somebody makes it.
    Coming,
    Held {
        value: Arc<V>,
        weight: u64,
        used: bool,
    },
}

impl<V: Weight> Cache<V> {
    /// An empty cache of at most `capacity` bytes.
    pub fn new(capacity: u64) -> Cache<V> {
        let state = State { places: HashMap::new(), round: VecDeque::new(), bytes: 0 };
        Cache { capacity, state: Mutex::new(state), made: Condvar::new() }
    }

    /// Bytes that are held.
    pub fn bytes(&self) -> u64 {
        self.state().bytes
    }

    /// Bytes that may be held.
    pub fn capacity(&self) -> u64 {
        self.capacity
    }

    /// The value of a number, made by `make` unless it is held. A value that alone is beyond the
    /// capacity is made each time.
    ///
    /// # Errors
    /// Of `make`; the next who asks tries again.
    pub fn get<E>(&self, key: u32, make: impl FnOnce() -> Result<V, E>) -> Result<Arc<V>, E> {
        let mut state = self.state();
        loop {
            match state.places.get_mut(&key) {
                Some(Place::Held { value, used, .. }) => {
                    *used = true;
                    return Ok(value.clone());
                }
                Some(Place::Coming) => {
                    state = self.made.wait(state).unwrap_or_else(PoisonError::into_inner);
                }
                None => break,
            }
        }
        state.places.insert(key, Place::Coming);
        drop(state);
        // Also when `make` fails or panics, those who wait must go on.
        let mut coming = Coming { cache: self, key, value: None };
        let value = Arc::new(make()?);
        coming.value = Some(value.clone());
        Ok(value)
    }

    fn state(&self) -> MutexGuard<'_, State<V>> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// The promise to make a value, kept or not when it is dropped.
struct Coming<'a, V: Weight> {
    cache: &'a Cache<V>,
    key: u32,
    value: Option<Arc<V>>,
}

impl<V: Weight> Drop for Coming<'_, V> {
    fn drop(&mut self) {
        // At once: what is held can be evicted and promised again by another, whose promise is not ours.
        let mut state = self.cache.state();
        state.places.remove(&self.key);
        if let Some(value) = self.value.take() {
            state.hold(self.key, value, self.cache.capacity);
        }
        drop(state);
        self.cache.made.notify_all();
    }
}

impl<V: Weight> State<V> {
    fn hold(&mut self, key: u32, value: Arc<V>, capacity: u64) {
        let weight = value.weight();
        if weight > capacity {
            return;
        }
        while self.bytes + weight > capacity {
            let Some(oldest) = self.round.pop_front() else { break };
            let Some(Place::Held { weight, used, .. }) = self.places.get_mut(&oldest) else {
                continue;
            };
            if std::mem::take(used) {
                self.round.push_back(oldest);
            } else {
                self.bytes -= *weight;
                self.places.remove(&oldest);
            }
        }
        self.bytes += weight;
        self.round.push_back(key);
        self.places.insert(key, Place::Held { value, weight, used: false });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use shuttle::sync::atomic::{AtomicU32, Ordering};
    use shuttle::thread;

    struct Bytes(u32);

    impl Weight for Bytes {
        fn weight(&self) -> u64 {
            10 + u64::from(self.0 % 3)
        }
    }

    /// Three threads ask for numbers in their own orders; one makes it fail now and then.
    fn asked_by_three() {
        let cache = Arc::new(Cache::<Bytes>::new(25));
        let being_made: Arc<[AtomicU32; 4]> = Arc::new(std::array::from_fn(|_| AtomicU32::new(0)));
        let threads: Vec<_> = (0..3u32)
            .map(|turn| {
                let (cache, being_made) = (cache.clone(), being_made.clone());
                thread::spawn(move || {
                    for k in 0..5 {
                        let key = (k * (turn + 1) + turn) % 4;
                        let fails = turn == 2 && k % 2 == 0;
                        let made = cache.get(key, || {
                            let others = being_made[key as usize].fetch_add(1, Ordering::SeqCst);
                            assert_eq!(others, 0, "made twice at once");
                            thread::yield_now();
                            being_made[key as usize].fetch_sub(1, Ordering::SeqCst);
                            if fails { Err(()) } else { Ok(Bytes(key)) }
                        });
                        assert!(made.is_ok_and(|value| value.0 == key) || fails);
                        assert!(cache.bytes() <= 25);
                    }
                })
            })
            .collect();
        threads.into_iter().for_each(|t| t.join().unwrap());
        let state = cache.state();
        let held = state.places.values().map(|place| match place {
            Place::Coming => panic!("nobody makes it any more"),
            Place::Held { weight, .. } => *weight,
        });
        assert_eq!(held.sum::<u64>(), state.bytes);
        assert_eq!(state.round.len(), state.places.len());
    }

    #[test]
    fn any_order_of_threads_gives_each_its_value_within_the_bound() {
        shuttle::check_random(asked_by_three, 2000);
        shuttle::check_pct(asked_by_three, 1000, 3);
    }

    #[test]
    fn what_is_used_stays_and_what_is_not_goes() {
        shuttle::check_random(
            || {
                let cache = Cache::<Bytes>::new(25);
                let mut made = Vec::new();
                for key in [0, 3, 0, 6, 0, 9, 0] {
                    let value = cache.get(key, || {
                        made.push(key);
                        Ok::<_, ()>(Bytes(key))
                    });
                    assert_eq!(value.unwrap().0, key);
                }
                assert_eq!(made, [0, 3, 6, 9]);
                let small = Cache::<Bytes>::new(5);
                for _ in 0..2 {
                    assert_eq!(small.get(1, || Ok::<_, ()>(Bytes(1))).unwrap().0, 1);
                    assert_eq!(small.bytes(), 0);
                }
            },
            1,
        );
    }
}
