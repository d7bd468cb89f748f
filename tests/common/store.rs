//! A field so small that it can be baked thousands of times, in any storage, and a look at what is
//! left of one.

use super::{parameters, scene_of, stored};
use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::Duration;
use vlf::bake::{BakeError, Options, Outcome, bake_in};
use vlf::field::storage::Storage;
use vlf::field::storage::memory::Memory;
use vlf::field::{Terms, files, read_manifest};
use vlf::format::manifest::Phase;
use vlf::format::names;
use vlf::{Parameters, Scene, Specular};

/// A floor, a lamp and a mirror.
const OBJ: &str = "\
v -1 0 1\nv 1 0 1\nv 1 0 -1\nv -1 0 -1
v -0.5 1.5 -0.5\nv 0.5 1.5 -0.5\nv 0.5 1.5 0.5\nv -0.5 1.5 0.5
v 1 1.5 -1\nv -1 1.5 -1
usemtl floor\nf 1 2 3 4
usemtl lamp\nf 5 6 7 8
usemtl mirror\nf 4 3 9 10
";

const MTL: &str = "\
newmtl floor\nKd 0.6 0.5 0.4
newmtl lamp\nKd 0 0 0\nKe 8 8 6
newmtl mirror\nillum 3\nKd 0 0 0\nKs 0.9 0.9 0.9
";

/// The scene and how it is baked.
#[derive(Clone)]
pub struct Tiny {
    pub scene: Scene,
    pub parameters: Parameters,
    pub memory: u64,
    pub threads: usize,
    pub force: bool,
    pub sync: bool,
    pub lock: bool,
}

impl Tiny {
    /// With mirrors' maps stored: the bake that has every kind of file in it.
    pub fn new() -> Tiny {
        let parameters = stored(Parameters { tile: 8, ..parameters(9, 16, 3) });
        let scene = scene_of(OBJ, MTL);
        let (memory, threads) = (1 << 28, 1);
        Tiny { scene, parameters, memory, threads, force: false, sync: true, lock: true }
    }

    /// With paths followed through the mirror, as `vlf bake` does without options.
    pub fn traced() -> Tiny {
        let parameters =
            Parameters { specular: Specular::Trace, resample: true, ..Tiny::new().parameters };
        Tiny { parameters, ..Tiny::new() }
    }

    /// Both ways of mirrors.
    pub fn both() -> [Tiny; 2] {
        [Tiny::new(), Tiny::traced()]
    }

    /// Bakes, or goes on baking, with a commit whenever there is anything to commit.
    pub fn bake(&self, storage: Arc<dyn Storage>) -> Result<Outcome, BakeError> {
        let options = Options {
            memory: self.memory,
            threads: self.threads,
            stop: &AtomicBool::new(false),
            progress: &|_| (),
            order: None,
            commit_every: 0.0,
            terms: Terms { sync: self.sync, lock: self.lock },
            force: self.force,
        };
        bake_in(storage, &self.scene, &self.parameters, &options)
    }

    /// What is left when nothing goes wrong.
    pub fn undisturbed(&self) -> Left {
        let disk = Arc::new(Memory::default());
        assert_eq!(self.bake(disk.clone()).unwrap(), Outcome::Finished);
        Left::of(&*disk)
    }
}

/// What a finished bake leaves: the digest, which files, and the bytes of those that must be the same.
#[derive(PartialEq)]
pub struct Left {
    pub digest: [u8; 16],
    pub files: BTreeMap<String, Option<Vec<u8>>>,
}

impl Left {
    pub fn of(storage: &dyn Storage) -> Left {
        let (_, manifest) = read_manifest(storage).unwrap();
        assert_eq!(manifest.phase, Phase::Finished);
        let mut all = Vec::new();
        for name in storage.list("").unwrap() {
            match storage.list(&name) {
                Ok(inside) => all.extend(inside.iter().map(|f| format!("{name}/{f}"))),
                Err(_) => all.push(name),
            }
        }
        // A manifest says how long the bake took; the lock, who baked.
        let is_same = |name: &str| name != names::LOCK && !names::MANIFESTS.contains(&name);
        let bytes = |name: &str| is_same(name).then(|| files::read(storage, name).unwrap());
        let files = all.into_iter().map(|name| (name.clone(), bytes(&name))).collect();
        Left { digest: manifest.digest, files }
    }

    /// Says where two differ.
    pub fn same_as(&self, other: &Left) -> Result<(), String> {
        let names = |left: &Left| left.files.keys().cloned().collect::<Vec<_>>();
        if names(self) != names(other) {
            return Err(format!("files {:?}, not {:?}", names(self), names(other)));
        }
        let differs =
            |(name, bytes): (&String, _)| (other.files[name] != bytes).then(|| name.clone());
        let files: Vec<String> =
            self.files.iter().filter_map(|(n, b)| differs((n, b.clone()))).collect();
        match files.is_empty() && self.digest == other.digest {
            true => Ok(()),
            false => Err(format!("another digest or other bytes in {files:?}")),
        }
    }
}

/// Number of the newest commit, after a check of everything that it names; `None` when there is none.
/// Nothing is wrong with it, save a commit record that was damaged on purpose.
pub fn newest_commit(storage: &dyn Storage, damaged: &str) -> Result<Option<u64>, String> {
    let is_begun = |name: &String| names::MANIFESTS.contains(&name.as_str());
    if !storage.list("").map_err(|e| e.to_string())?.iter().any(is_begun) {
        return Ok(None);
    }
    let report = vlf::verify::field(storage, &|_| ()).map_err(|e| e.to_string())?;
    let commit = report.state.map(|s| s.commit);
    match report.findings.iter().find(|f| f.file != damaged) {
        Some(finding) => Err(format!("commit {commit:?} is not whole: {finding}")),
        None => Ok(commit),
    }
}

/// Runs something that must not hang.
pub fn in_time<T: Send + 'static>(what: &str, run: impl FnOnce() -> T + Send + 'static) -> T {
    let (sender, receiver) = channel();
    let thread = std::thread::spawn(move || sender.send(run()));
    match receiver.recv_timeout(Duration::from_secs(60)) {
        Ok(result) => result,
        Err(RecvTimeoutError::Timeout) => panic!("{what}: hangs"),
        Err(RecvTimeoutError::Disconnected) => {
            std::panic::resume_unwind(thread.join().expect_err("gone without a word"))
        }
    }
}

/// Runs something for all numbers, on all processors.
pub fn for_all(numbers: impl Iterator<Item = u64> + Send, run: impl Fn(u64) + Sync) {
    let numbers = Mutex::new(numbers);
    let next = || numbers.lock().unwrap_or_else(PoisonError::into_inner).next();
    let work = || {
        while let Some(k) = next() {
            run(k);
        }
    };
    let threads = std::thread::available_parallelism().map_or(2, usize::from);
    std::thread::scope(|scope| {
        for thread in (0..threads).map(|_| scope.spawn(work)).collect::<Vec<_>>() {
            // With its own words.
            if let Err(panic) = thread.join() {
                std::panic::resume_unwind(panic);
            }
        }
    });
}
