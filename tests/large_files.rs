//! Files beyond 2^32 bytes: chunks are found on both sides of every power of two at which an offset of
//! 32 bits would wrap. The file has holes, so it takes little of the disk.

use std::fs::File;
use std::io::{self, Seek, SeekFrom, Write};
use vlf::directions::paging;
use vlf::field::files;
use vlf::format::container::{
    ChunkId, ChunkKind, Codec, ContainerWriter, FileKind, Header, NO_DIRECTION,
};
use vlf::format::limits::Limits;
use vlf::look::packed::{Access, PackFile};

/// Leaves a hole where zeros are written.
struct Sparse(File);

impl Write for Sparse {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        if bytes.iter().all(|b| *b == 0) {
            self.0.seek_relative(bytes.len() as i64)?;
            return Ok(bytes.len());
        }
        self.0.write(bytes)
    }

    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl Seek for Sparse {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.0.seek(to)
    }
}

#[test]
fn chunks_are_found_beyond_four_gibibytes() {
    let folder = tempfile::TempDir::new().unwrap();
    let path = folder.path().join("large.vlf");
    let header = Header {
        kind: FileKind::Pack,
        field: [7; 16],
        directions: 9,
        resolution: 8192,
        tile: 256,
        exponent: 0,
        surfaces: 1 << 20,
        generation: 0,
        direction: NO_DIRECTION,
        required_to_write: 0,
        optional: 0,
    };
    let id = |kind, direction| ChunkId { kind, cycle: 1, direction };
    let mut writer =
        ContainerWriter::new(Sparse(File::create(&path).unwrap()), header, 12).unwrap();
    for kind in [ChunkKind::Record, ChunkKind::Scene, ChunkKind::TotalTexture] {
        writer.chunk(id(kind, NO_DIRECTION), Codec::Raw, b"!").unwrap();
    }
    let hole = vec![0; 1 << 20];
    let order = paging(9).unwrap();
    for (place, direction) in order.iter().map(|id| id.0).enumerate() {
        let id = id(ChunkKind::Total, direction);
        if [1, 3].contains(&place) {
            writer.raw_chunk(id, std::iter::repeat_n(&hole, 1 << 11)).unwrap();
        } else {
            writer.chunk(id, Codec::Raw, &[b'a' + direction as u8; 100]).unwrap();
        }
    }
    let length = writer.length();
    // Whatever the last bytes are, the file reaches to its end.
    writer.finish().unwrap().0.set_len(length).unwrap();
    assert!(length > 1 << 32);

    let mut opened = files::open_at(&path, FileKind::Pack, &Limits::default()).unwrap();
    for (place, beyond) in [(0, 0), (2, 1u64 << 31), (4, 1 << 32)] {
        let direction = order[place].0;
        let expected = [b'a' + direction as u8; 100];
        let entry = opened.find(ChunkKind::Total, direction).unwrap();
        assert!(entry.offset > beyond, "{direction} at {}", entry.offset);
        assert_eq!(opened.chunk(&entry).unwrap(), expected);
        for access in [Access::Mapped, Access::Read] {
            let file = PackFile::open(&path, access).unwrap();
            let directory = file.directory(&Limits::default()).unwrap();
            assert_eq!(*file.chunk(&directory, &entry).unwrap(), expected, "{access:?}");
        }
    }
}
