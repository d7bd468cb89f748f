//! The thread that takes the pictures, so that keys and mouse never wait for one.

use crate::paint::{Frame, Job, paint};
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
            for (source, job) in todo {
                let frame = paint(&source, &job, &stopped);
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
