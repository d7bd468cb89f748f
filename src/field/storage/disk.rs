//! The real disk.

use super::{Input, Lock, LockError, Output, Storage};
use crate::format::limits::Limits;
use crate::format::names;
use fs4::FileExt;
use std::fs::{self, File, TryLockError};
use std::io::{self, Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

/// A folder of the file system.
pub struct Disk {
    root: PathBuf,
    limits: Limits,
}

impl Disk {
    /// The folder at a path, which need not be there yet.
    pub fn new(root: &Path) -> Disk {
        Disk::within(root, Limits::default())
    }

    /// The same, with other limits on what its files may state.
    pub fn within(root: &Path, limits: Limits) -> Disk {
        Disk { root: root.to_owned(), limits }
    }

    fn path(&self, name: &str) -> PathBuf {
        if name.is_empty() { self.root.clone() } else { self.root.join(name) }
    }

    /// A handle that a lock can be put on: the folder itself, whose name may change while the lock
    /// stands, or a file in it where folders cannot be opened.
    fn lockable(&self) -> io::Result<File> {
        if cfg!(unix) {
            return File::open(&self.root);
        }
        File::options().create(true).truncate(false).write(true).open(self.path(names::LOCK))
    }

    /// What the one who holds the lock says of itself.
    fn note(&self) -> io::Result<String> {
        let mut bytes = [0; 200];
        let length = self.open(names::LOCK)?.read_at(0, &mut bytes)?;
        Ok(String::from_utf8_lossy(&bytes[..length]).into_owned())
    }
}

/// The folder that a file or folder is in.
fn parent(path: &Path) -> &Path {
    path.parent().filter(|p| *p != Path::new("")).unwrap_or(Path::new("."))
}

impl Storage for Disk {
    fn place(&self) -> &Path {
        &self.root
    }

    fn limits(&self) -> Limits {
        self.limits
    }

    fn make(&self) -> io::Result<()> {
        if self.root.is_dir() {
            // Who made it may have been stopped before its name had reached the disk. Where the
            // folder around it cannot be opened, someone else has made it.
            return match File::open(parent(&self.root)) {
                Ok(_) => sync_folder(parent(&self.root)),
                Err(_) => Ok(()),
            };
        }
        // Every folder that is new has its name in the one around it.
        let is_new = |p: &&Path| *p != Path::new("") && !p.is_dir();
        let new: Vec<&Path> = self.root.ancestors().take_while(is_new).collect();
        fs::create_dir_all(&self.root)?;
        new.into_iter().try_for_each(|folder| sync_folder(parent(folder)))
    }

    fn lock(&self, note: &str) -> Result<Lock, LockError> {
        let file = self.lockable().map_err(LockError::Unsupported)?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => {
                return Err(LockError::Held(self.note().unwrap_or_default()));
            }
            Err(TryLockError::Error(e)) => return Err(LockError::Unsupported(e)),
        }
        // For people only: no note is no harm.
        let _ = self.create(names::LOCK, 0).and_then(|mut file| file.write_all(note.as_bytes()));
        Ok(Box::new(file))
    }

    fn list(&self, folder: &str) -> io::Result<Vec<String>> {
        // What a link leads to is not the field's.
        if !folder.is_empty() && !fs::symlink_metadata(self.path(folder))?.is_dir() {
            return Err(io::ErrorKind::NotADirectory.into());
        }
        let mut all = Vec::new();
        let entries = fs::read_dir(self.path(folder)).map_err(|e| match e.kind() {
            // A file on the way to the field is no field.
            io::ErrorKind::NotADirectory if fs::symlink_metadata(&self.root).is_err() => {
                io::ErrorKind::NotFound.into()
            }
            _ => e,
        })?;
        for entry in entries {
            all.push(entry?.file_name().to_string_lossy().into_owned());
        }
        all.sort();
        Ok(all)
    }

    fn open(&self, name: &str) -> io::Result<Box<dyn Input>> {
        let path = self.path(name);
        // Before it is opened: a pipe would let its reader wait.
        if !fs::metadata(&path)?.is_file() {
            return Err(io::Error::other("not a regular file"));
        }
        Ok(Box::new(File::open(path)?))
    }

    fn create(&self, name: &str, reserve: u64) -> io::Result<Box<dyn Output>> {
        let path = self.path(name);
        // Not through a link, nor into a device or a pipe: those are not the field's.
        if fs::symlink_metadata(&path).is_ok_and(|m| !m.is_file()) {
            return Err(io::Error::other("not a regular file"));
        }
        let file = File::create(path)?;
        if reserve > 0 {
            let reserved = loop {
                match FileExt::allocate(&file, reserve) {
                    // By a signal.
                    Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
                    result => break result,
                }
            };
            match reserved {
                // Some file systems cannot; then running full is found out while writing.
                Err(e) if e.kind() == io::ErrorKind::Unsupported => {}
                result => result?,
            }
        }
        Ok(Box::new(file))
    }

    fn rename(&self, from: &str, to: &str) -> io::Result<()> {
        fs::rename(self.path(from), self.path(to))
    }

    fn remove(&self, name: &str) -> io::Result<()> {
        fs::remove_file(self.path(name))
    }

    fn create_folder(&self, folder: &str) -> io::Result<()> {
        match fs::create_dir(self.path(folder)) {
            Err(e) if e.kind() == io::ErrorKind::AlreadyExists => self.list(folder).map(|_| ()),
            result => result,
        }
    }

    fn remove_folder(&self, folder: &str) -> io::Result<()> {
        fs::remove_dir(self.path(folder))
    }

    fn sync_folder(&self, folder: &str) -> io::Result<()> {
        sync_folder(&self.path(folder))
    }

    fn sync_file(&self, name: &str) -> io::Result<()> {
        // Some systems sync only what could be written.
        File::options().write(true).open(self.path(name))?.sync_all()
    }

    fn free(&self) -> Option<u64> {
        // The folder itself may not be there yet.
        let there = self.root.ancestors().find(|p| p.is_dir()).unwrap_or(Path::new("."));
        fs4::available_space(there).ok()
    }
}

fn sync_folder(path: &Path) -> io::Result<()> {
    // Elsewhere folders cannot be opened, and renaming is as lasting as it gets.
    if !cfg!(unix) {
        return Ok(());
    }
    match File::open(path)?.sync_all() {
        // Some file systems have no sync of folders.
        Err(e) if matches!(e.kind(), io::ErrorKind::InvalidInput | io::ErrorKind::Unsupported) => {
            Ok(())
        }
        result => result,
    }
}

impl Input for File {
    fn length(&self) -> io::Result<u64> {
        Ok(self.metadata()?.len())
    }

    fn read_at(&mut self, at: u64, into: &mut [u8]) -> io::Result<usize> {
        self.seek(SeekFrom::Start(at))?;
        self.read(into)
    }
}

impl Output for File {
    fn sync(&mut self) -> io::Result<()> {
        self.flush()?;
        self.sync_all()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn disk() -> (tempfile::TempDir, Disk) {
        let folder = tempfile::TempDir::new().unwrap();
        let disk = Disk::new(&folder.path().join("new/newer/a.field"));
        disk.make().unwrap();
        disk.make().unwrap();
        (folder, disk)
    }

    #[test]
    fn files_are_made_read_renamed_listed_and_removed() {
        let (_folder, disk) = disk();
        assert_eq!(disk.list("f").unwrap_err().kind(), io::ErrorKind::NotFound);
        disk.create_folder("f").unwrap();
        disk.create_folder("f").unwrap();
        let mut file = disk.create("f/a", 100).unwrap();
        file.write_all(&[7; 100]).unwrap();
        file.sync().unwrap();
        disk.sync_folder("f").unwrap();
        disk.rename("f/a", "f/b").unwrap();
        assert_eq!(disk.list("f").unwrap(), ["b"]);
        let mut input = disk.open("f/b").unwrap();
        let mut bytes = [0; 100];
        input.read_exact_at(0, &mut bytes).unwrap();
        assert_eq!((input.length().unwrap(), bytes), (100, [7; 100]));
        let beyond = input.read_exact_at(1, &mut bytes).unwrap_err();
        assert_eq!(beyond.kind(), io::ErrorKind::UnexpectedEof);
        assert!(disk.remove_folder("f").is_err(), "not empty");
        disk.remove("f/b").unwrap();
        disk.remove_folder("f").unwrap();
        assert_eq!(disk.list("").unwrap(), Vec::<String>::new());
        assert!(disk.free().unwrap() > 0);
    }

    #[test]
    fn the_lock_is_the_folders_and_says_whose_it_is() {
        let (_folder, disk) = disk();
        let held = disk.lock("me").unwrap();
        for _ in 0..2 {
            match disk.lock("you") {
                Err(LockError::Held(note)) => assert!(note == "me" || note.is_empty()),
                _ => panic!("two writers"),
            }
            let _ = fs::remove_file(disk.path(names::LOCK));
        }
        drop(held);
        disk.lock("you").unwrap();
    }

    /// A field that someone else packed up may hold links to what is ours.
    #[cfg(unix)]
    #[test]
    fn links_pipes_and_devices_are_not_written_through_nor_waited_for() {
        let (folder, disk) = disk();
        let ours = folder.path().join("ours");
        fs::create_dir(&ours).unwrap();
        fs::write(ours.join("letter"), "Dear reader").unwrap();
        let link = |to: &Path, name: &str| std::os::unix::fs::symlink(to, disk.path(name)).unwrap();
        link(&ours.join("letter"), "manifest-0.tmp");
        link(&ours.join("letter"), names::LOCK);
        link(&ours, "unshot-0001");
        link(Path::new("/dev/zero"), "scene");
        drop(disk.lock("note").unwrap());
        assert!(disk.create("manifest-0.tmp", 0).is_err());
        assert!(disk.create("scene", 0).is_err());
        assert!(disk.open("scene").is_err());
        assert!(disk.list("unshot-0001").is_err());
        assert!(disk.create_folder("unshot-0001").is_err());
        let pipe = std::process::Command::new("mkfifo").arg(disk.path("manifest-1")).status();
        if pipe.is_ok_and(|s| s.success()) {
            assert!(disk.open("manifest-1").is_err());
            assert!(disk.create("manifest-1", 0).is_err());
        } else {
            eprintln!("no pipes here: links and devices stand for them");
        }
        assert_eq!(fs::read_to_string(ours.join("letter")).unwrap(), "Dear reader");
    }
}
