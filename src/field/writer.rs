//! Writers behind: tile files are written by threads of their own, so that the disk and the cores
//! work at once. The queue is bounded; when the disk is slower, those who make the maps wait.

use super::{Field, FieldError};
use crate::format::container::ChunkKind;
use crossbeam::channel::{Receiver, Sender, bounded};
use std::thread;

/// Threads that write: a sync waits for the disk, and several wait together.
pub const WRITERS: usize = 4;

/// Directions whose maps may wait to be written.
pub const WAITING: usize = 2;

/// The tile maps of a direction: what each is, and its bytes.
pub type Maps = Vec<(ChunkKind, Vec<u8>)>;

/// Takes maps to be written.
pub struct Queue<'a> {
    field: &'a Field,
    sender: Sender<(u32, Maps)>,
}

impl Queue<'_> {
    /// Hands a direction's maps over, waiting while the queue is full.
    ///
    /// # Errors
    /// [`FieldError::Poisoned`] when the writers have stopped at an error: [`behind`] returns that.
    pub fn put(&self, direction: u32, maps: Maps) -> Result<(), FieldError> {
        let gone = |_| FieldError::Poisoned(self.field.path().to_owned());
        self.sender.send((direction, maps)).map_err(gone)
    }
}

/// Runs `work` with a queue to writers of tile files into `folder`. When this returns, all that was
/// handed over is written.
///
/// # Errors
/// The first of the writers, else that of `work`.
pub fn behind<T>(
    field: &Field,
    (folder, generation): (&str, u32),
    work: impl FnOnce(&Queue) -> Result<T, FieldError>,
) -> Result<T, FieldError> {
    let (sender, receiver) = bounded::<(u32, Maps)>(WAITING);
    thread::scope(|scope| {
        let write = |jobs: Receiver<(u32, Maps)>| -> Result<(), FieldError> {
            for (direction, maps) in jobs {
                field.write_tiles(folder, (generation, direction), &maps)?;
            }
            Ok(())
        };
        // Each has its own end: when all writers have stopped, who hands over finds out.
        let ends: Vec<_> = (0..WRITERS).map(|_| receiver.clone()).collect();
        drop(receiver);
        let writers: Vec<_> = ends.into_iter().map(|e| scope.spawn(move || write(e))).collect();
        let queue = Queue { field, sender };
        let result = work(&queue);
        drop(queue);
        let mut first = Ok(());
        for writer in writers {
            match writer.join() {
                Ok(Err(FieldError::Poisoned(_)) | Ok(())) => {}
                Ok(Err(error)) => first = first.and(Err(error)),
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        first.and(result)
    })
}
