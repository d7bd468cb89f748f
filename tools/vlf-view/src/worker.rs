//! The thread that takes the pictures, so that keys and mouse never wait for one.

use crate::paint::{Frame, Job, Spare, paint};
use crate::source::Source;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::mpsc::{Sender, channel};
use std::thread;

/// Takes pictures, one after the other.
pub struct Worker {
    jobs: Sender<(Arc<Source>, Job)>,
    stop: Arc<AtomicBool>,
}

impl Worker {
    /// Starts it. `done` is told each job that was begun, with its picture unless it was overtaken.
    pub fn new(done: impl Fn(Job, Option<Frame>) + Send + 'static) -> Worker {
        let (jobs, todo) = channel::<(Arc<Source>, Job)>();
        let stop = Arc::new(AtomicBool::new(false));
        let stopped = stop.clone();
        thread::spawn(move || {
            let mut spare = Spare::default();
            for (source, job) in todo {
                let frame = paint(&source, &job, &stopped, &mut spare);
                done(job, frame);
            }
        });
        Worker { jobs, stop }
    }

    /// Begins a job; the one before is done. False when the thread has died.
    pub fn begin(&self, source: Arc<Source>, job: Job) -> bool {
        self.stop.store(false, Ordering::Relaxed);
        self.jobs.send((source, job)).is_ok()
    }

    /// The job under way is of no use any more.
    pub fn overtake(&self) {
        self.stop.store(true, Ordering::Relaxed);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pace::Pass;
    use crate::paint::{Look, Method, Shot};
    use crate::testing::{opening, pack};
    use std::time::{Duration, Instant};
    use vlf::Camera;
    use vlf::look::tone::Curve;

    #[test]
    fn a_picture_that_is_overtaken_ends_soon_and_the_next_begins() {
        let (_folder, pack) = pack();
        let source = Arc::new(opening(&pack).open().unwrap());
        let job = |width, samples| {
            let camera = Camera { width, height: width, ..source.start };
            let pass = Pass { coarse: 1, samples };
            let look = Look { exposure: Some(0.0), curve: Curve::Plain };
            Job::Take(Shot { camera, pass, method: Method::Trace }, look)
        };
        let (done, dones) = channel();
        let worker = Worker::new(move |_, frame| done.send(frame.is_some()).unwrap());
        // Minutes of work.
        assert!(worker.begin(source.clone(), job(4000, 16)));
        thread::sleep(Duration::from_millis(500));
        assert!(dones.try_recv().is_err());
        let asked = Instant::now();
        worker.overtake();
        assert_eq!(dones.recv(), Ok(false));
        // A few pixels on each thread; it is seconds because machines are busy.
        let waited = asked.elapsed();
        assert!(waited < Duration::from_secs(10), "{waited:?}");
        assert!(worker.begin(source.clone(), job(8, 1)));
        assert_eq!(dones.recv(), Ok(true));
    }
}
