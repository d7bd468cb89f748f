//! Reading ahead: which unshot maps a step will gather from, and a queue that brings them in before
//! the step begins.

use super::reach::Sealed;
use super::step::Shared;
use crate::field::FieldError;
use crate::field::pages::Pages;
use crate::format::container::ChunkKind;
use crate::gather::{Around, mirrored};
use crate::ids::{DirectionId, Sense, Side};
use crossbeam::channel::{Receiver, Sender, bounded};
use std::sync::atomic::{AtomicUsize, Ordering};
use std::thread;

/// Threads that read.
const READERS: usize = 2;

/// Directions for each worker that may wait with their pages read.
const AHEAD: usize = 2;

/// Directions whose unshot maps the mirrors gather from when light is shot along `id`.
pub fn gathered_from(shared: &Shared, sealed: &Sealed, id: DirectionId) -> Vec<u32> {
    let texels = shared.texels;
    let mut wanted = Vec::new();
    let along = shared.directions.vector(id);
    for texel in texels.diffuse as usize..texels.len() {
        let normal = shared.scene.surfaces[texels.surface_of[texel] as usize].normal;
        for sense in [Sense::Along, Sense::Against] {
            let outgoing = along * sense.sign();
            let side = Side::facing(normal.dot(outgoing));
            if sealed.has(2 * texel + side.index()) {
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
    pub sealed: &'a Sealed,
}

impl Wanted<'_> {
    fn read(&self, direction: u32) -> Result<(), FieldError> {
        let Some(pages) = self.pages else { return Ok(()) };
        pages.read_ahead(direction, ChunkKind::Arrived)?;
        if self.gathers {
            for near in gathered_from(self.shared, self.sealed, DirectionId(direction)) {
                pages.read_ahead(near, ChunkKind::Unshot)?;
            }
        }
        Ok(())
    }
}

/// Runs `work` with a queue of directions, in order, whose pages have been read if there was room.
/// No more come once `enough` says so.
///
/// # Errors
/// That of `work`. A reader's is left to the step that needs the page: it will meet it again.
pub fn ahead<T>(
    wanted: &Wanted,
    todo: &[u32],
    workers: usize,
    enough: impl Fn() -> bool + Sync,
    work: impl FnOnce(&Receiver<u32>) -> Result<T, FieldError>,
) -> Result<T, FieldError> {
    let (sender, receiver) = bounded(AHEAD * workers);
    let next = AtomicUsize::new(0);
    let read = |sender: Sender<u32>| {
        while let Some(direction) = todo.get(next.fetch_add(1, Ordering::Relaxed)) {
            // Only pages are lost by a failure here: the step reads them itself, and says why.
            let _ = wanted.read(*direction);
            if enough() || sender.send(*direction).is_err() {
                return;
            }
        }
    };
    let read = &read;
    thread::scope(|scope| {
        for sender in vec![sender; READERS] {
            scope.spawn(move || read(sender));
        }
        let result = work(&receiver);
        // Readers that wait to hand a direction over are let go.
        drop(receiver);
        result
    })
}
