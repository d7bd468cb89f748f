//! Writers behind: tile files are written by a thread of their own, so that the disk and the cores work
//! at once. The queue is bounded; when the disk is slower, those who make the maps wait.

use super::{Field, FieldError};
use crate::format::container::ChunkKind;
use crossbeam::channel::{Sender, bounded};
use std::thread;

/// Directions whose maps may wait to be written.
const WAITING: usize = 8;

/// The tile maps of a direction: what each is, and its bytes.
pub type Maps = Vec<(ChunkKind, Vec<u8>)>;

/// Takes maps to be written.
pub struct Queue(Sender<(u32, Maps)>);

impl Queue {
    /// Hands a direction's maps over, waiting while the queue is full. Nothing happens when the writer
    /// has stopped at an error: [`behind`] returns it.
    pub fn put(&self, direction: u32, maps: Maps) {
        // An error means that the receiver has gone, and with it the need.
        let _ = self.0.send((direction, maps));
    }
}

/// Runs `work` with a queue to a writer of tile files into `folder`. When this returns, all that was
/// handed over is written.
///
/// # Errors
/// The first of the writer; what `work` returned is lost then.
pub fn behind<T>(
    field: &Field,
    (folder, generation): (&str, u32),
    work: impl FnOnce(&Queue) -> T,
) -> Result<T, FieldError> {
    let (sender, receiver) = bounded::<(u32, Maps)>(WAITING);
    thread::scope(|scope| {
        let writer = scope.spawn(move || -> Result<(), FieldError> {
            for (direction, maps) in receiver {
                let maps: Vec<_> = maps.iter().map(|(kind, b)| (*kind, b.as_slice())).collect();
                field.write_tiles(folder, (generation, direction), &maps)?;
            }
            Ok(())
        });
        let queue = Queue(sender);
        let result = work(&queue);
        drop(queue);
        match writer.join() {
            Ok(written) => written.map(|()| result),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}
