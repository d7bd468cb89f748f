//! What the control groups of Linux allow this process.

use std::fs::read_to_string;
use std::path::{Path, PathBuf};

/// Bytes of memory that the control groups of this process allow it, where there are any.
pub fn memory_limit() -> Option<u64> {
    let groups = read_to_string("/proc/self/cgroup").ok()?;
    least(&files(Path::new("/sys/fs/cgroup"), &groups))
}

/// The files that may state a limit, by what `/proc/self/cgroup` says: one a group and each group
/// around it, of version 2 (`0::/GROUP`) and of version 1 (`N:...,memory,...:/GROUP`). In a container
/// a group may be mounted as the root, which is among those around it.
fn files(root: &Path, groups: &str) -> Vec<PathBuf> {
    let file = |line: &str| {
        let mut parts = line.splitn(3, ':');
        let (_, controllers, group) = (parts.next()?, parts.next()?, parts.next()?);
        let (folder, file) = match controllers {
            "" => (root.to_owned(), "memory.max"),
            of if of.split(',').any(|c| c == "memory") => {
                (root.join("memory"), "memory.limit_in_bytes")
            }
            _ => return None,
        };
        let around = Path::new(group.trim_start_matches('/')).ancestors();
        Some(around.map(|group| folder.join(group).join(file)).collect::<Vec<_>>())
    };
    groups.lines().filter_map(file).flatten().collect()
}

/// The least number that any of the files states; `max` is none.
fn least(files: &[PathBuf]) -> Option<u64> {
    files.iter().filter_map(|file| read_to_string(file).ok()?.trim().parse().ok()).min()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::fs;

    fn limit(groups: &str, stated: &[(&str, &str)]) -> Option<u64> {
        let root = tempfile::TempDir::new().unwrap();
        for (file, text) in stated {
            let file = root.path().join(file);
            fs::create_dir_all(file.parent().unwrap()).unwrap();
            fs::write(file, text).unwrap();
        }
        least(&files(root.path(), groups))
    }

    #[test]
    fn the_tightest_group_of_either_version_counts() {
        let two = [("a/b/memory.max", "max\n"), ("a/memory.max", "4096\n"), ("c/memory.max", "1")];
        assert_eq!(limit("0::/a/b\n", &two), Some(4096));
        let one = [
            ("memory/jobs/7/memory.limit_in_bytes", "9223372036854771712\n"),
            ("memory/jobs/memory.limit_in_bytes", "8192\n"),
            ("cpu/jobs/7/memory.limit_in_bytes", "1\n"),
        ];
        let groups = "5:cpu,cpuacct:/jobs/7\n4:memory:/jobs/7\n0::/\n";
        assert_eq!(limit(groups, &one), Some(8192));
        // Seen from inside a container.
        let inside = [("memory/memory.limit_in_bytes", "512")];
        assert_eq!(limit("3:hugetlb,memory:/docker/0123\n", &inside), Some(512));
        assert_eq!(limit("", &two), None);
        assert_eq!(limit("nonsense\n0::/d", &two), None);
    }
}
