//! Reading ahead: which unshot maps a step will gather from, and a queue that brings them in before
//! the step begins.

use super::marks::Marks;
use super::step::Shared;
use crate::field::FieldError;
use crate::field::pages::Pages;
use crate::format::container::ChunkKind;
use crate::gather::{Around, mirrored};
use crate::ids::{DirectionId, Sense, Side};
use crossbeam::channel::{Receiver, Sender, bounded};
use std::convert::Infallible;
use std::sync::atomic::{AtomicUsize, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::{slice, thread};

/// Threads that read.
const READERS: usize = 2;

/// Directions for each worker that may wait with their pages read.
const AHEAD: usize = 2;

/// Directions whose unshot maps the mirrors gather from when light is shot along `id`.
pub fn gathered_from(shared: &Shared, marks: &Marks, id: DirectionId) -> Vec<u32> {
    let texels = shared.texels;
    let mut wanted = Vec::new();
    let along = shared.directions.vector(id);
    for texel in texels.diffuse as usize..texels.len() {
        let normal = shared.scene.surfaces[texels.surface_of[texel] as usize].normal;
        for sense in [Sense::Along, Sense::Against] {
            let outgoing = along * sense.sign();
            let side = Side::facing(normal.dot(outgoing));
            if marks.is_sealed(2 * texel + side.index()) {
                continue;
            }
            let facing = normal * side.sign();
            let source = mirrored(outgoing, facing);
            let around =
                Around::new(shared.directions, shared.parameters.resolution, source, facing);
            wanted.extend(around.near.iter().filter(|n| n.weight > 0.0).map(|n| n.direction.0));
        }
    }
    wanted.sort_unstable();
    wanted.dedup();
    wanted
}

/// What a step needs to be in memory.
pub struct Wanted<'a> {
    /// Where from; `None`: nothing is.
    pub pages: Option<&'a Pages>,
    /// Whether mirrors gather, or the direction's own map is all that is needed.
    pub gathers: bool,
    /// The bake.
    pub shared: &'a Shared<'a>,
    /// Texture values that no light can come to.
    pub marks: &'a Marks,
}

impl Wanted<'_> {
    fn read(&self, direction: u32) -> Result<(), FieldError> {
        let Some(pages) = self.pages else { return Ok(()) };
        pages.read_ahead(direction, ChunkKind::Arrived)?;
        if self.gathers {
            for near in gathered_from(self.shared, self.marks, DirectionId(direction)) {
                pages.read_ahead(near, ChunkKind::Unshot)?;
            }
        }
        Ok(())
    }
}

/// A direction that a reader has begun with, and what ends once its pages are there.
type Begun = (u32, Receiver<Infallible>);

/// Directions in the order asked for.
pub enum Queue<'a> {
    /// Each is handed out once its pages have been read, if there was room.
    Read(Receiver<Begun>),
    /// Nothing has to be read for them: those from a place on, until it is enough.
    Plain(&'a [u32], AtomicUsize, &'a (dyn Fn() -> bool + Sync)),
}

impl Iterator for &Queue<'_> {
    type Item = u32;

    fn next(&mut self) -> Option<u32> {
        match self {
            Queue::Read(begun) => {
                let (direction, read) = begun.recv().ok()?;
                // Nothing is ever sent: the reader lets go of the other end.
                let _ = read.recv();
                Some(direction)
            }
            Queue::Plain(_, _, enough) if enough() => None,
            Queue::Plain(todo, next, _) => todo.get(next.fetch_add(1, Ordering::Relaxed)).copied(),
        }
    }
}

/// Runs `work` with a queue of the directions of `todo`. No more come once `enough` says so.
///
/// # Errors
/// That of `work`. A reader's is left to the step that needs the page: it will meet it again.
pub fn ahead<T>(
    wanted: &Wanted,
    todo: &[u32],
    workers: usize,
    enough: impl Fn() -> bool + Sync,
    work: impl FnOnce(&Queue) -> Result<T, FieldError>,
) -> Result<T, FieldError> {
    if wanted.pages.is_none() {
        return work(&Queue::Plain(todo, AtomicUsize::new(0), &enough));
    }
    let (sender, receiver) = bounded(AHEAD * workers);
    // Held while a direction is put into the queue, so that two readers keep their order.
    let left = Arc::new(Mutex::new((todo.iter(), sender)));
    let begin = |left: &Mutex<(slice::Iter<u32>, Sender<Begun>)>| {
        let mut left = left.lock().unwrap_or_else(PoisonError::into_inner);
        let direction = *left.0.next()?;
        let (reading, read) = bounded(0);
        (!enough() && left.1.send((direction, read)).is_ok()).then_some((direction, reading))
    };
    let (begin, queue) = (&begin, Queue::Read(receiver));
    thread::scope(move |scope| {
        // The last of them takes the sender with it, which ends the queue.
        for left in vec![left; READERS] {
            scope.spawn(move || {
                while let Some((direction, reading)) = begin(&left) {
                    // Only pages are lost by a failure here: the step reads them itself, and says why.
                    let _ = wanted.read(direction);
                    drop(reading);
                }
            });
        }
        // This takes the queue with it, before the readers are waited for: those that wait for room in
        // it are let go.
        work(&queue)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::bake::layers::Outlines;
    use crate::bake::transfer::Quantum;
    use crate::directions::Directions;
    use crate::format::manifest::{Parameters, Specular};
    use crate::scene::Scene;

    /// Maps that have to be read when the last `room` maps used are kept.
    fn reads(
        order: &[DirectionId],
        room: usize,
        gathered: impl Fn(DirectionId) -> Vec<u32>,
    ) -> usize {
        let (mut kept, mut reads) = (Vec::new(), 0);
        for map in order.iter().flat_map(|id| gathered(*id)) {
            match kept.iter().position(|k| *k == map) {
                Some(at) => drop(kept.remove(at)),
                None => reads += 1,
            }
            kept.push(map);
            if kept.len() > room {
                kept.remove(0);
            }
        }
        reads
    }

    #[test]
    fn directions_come_in_order_and_the_queue_ends() {
        let (scene, _) = Scene::bundled("cornell_mirror").unwrap();
        let parameters = Parameters::default();
        let texels = crate::bake::texels(&scene, &parameters);
        let shared = Shared {
            scene: &scene,
            texels: &texels,
            outlines: &Outlines::new(&scene, &texels),
            directions: &Directions::with_lines(9).unwrap(),
            parameters: &parameters,
            quantum: Quantum::new(1.0),
            exponent: 0,
        };
        let marks = Marks::new(&texels);
        let wanted = Wanted { pages: None, gathers: false, shared: &shared, marks: &marks };
        let todo: Vec<u32> = (0..200).rev().collect();
        let all = |queue: &Queue| Ok(queue.into_iter().collect::<Vec<_>>());
        for _ in 0..50 {
            assert_eq!(ahead(&wanted, &todo, 2, || false, all).unwrap(), todo);
        }
        let none = ahead(&wanted, &todo, 2, || true, all).unwrap();
        assert!(none.is_empty());
        // One that takes no more lets the readers go.
        let first = |mut queue: &Queue| Ok(queue.next());
        assert_eq!(ahead(&wanted, &todo, 1, || false, first).unwrap(), Some(199));
    }

    #[test]
    fn with_little_room_fewer_maps_are_read_again_along_the_curve() {
        let (scene, _) = Scene::bundled("cornell_mirror").unwrap();
        let parameters = Parameters {
            directions: 2049,
            resolution: 32,
            tile: 16,
            cycles: None,
            unshot_fraction: 1e-3,
            perturbations: vec![1],
            texel_cells: 1.0,
            filter: 0,
            one_sided: false,
            specular: Specular::Maps,
            resample: false,
            ..Parameters::default()
        };
        let texels = crate::bake::texels(&scene, &parameters);
        let directions = Directions::with_lines(2049).unwrap();
        let shared = Shared {
            scene: &scene,
            texels: &texels,
            outlines: &Outlines::new(&scene, &texels),
            directions: &directions,
            parameters: &parameters,
            quantum: Quantum::new(1.0),
            exponent: 0,
        };
        let marks = Marks::new(&texels);
        let by_id: Vec<DirectionId> = directions.ids().collect();
        // With room for a tenth or more, rows of the lattice would do as well: 4700 reads against 5400
        // at 256. Little room is what the order is for. Each map is wanted by some directions only, so
        // the reads themselves are bounded too: either could be had at the other's cost.
        for (room, most) in [(32, 8000), (64, 7000), (128, 6000)] {
            let reads =
                |order: &[DirectionId]| reads(order, room, |id| gathered_from(&shared, &marks, id));
            let (curve, rows) = (reads(&directions.curve()), reads(&by_id));
            assert!(
                curve < most && 6 * curve < 5 * rows,
                "room for {room}: {curve} reads, {rows} by id"
            );
        }
    }
}
