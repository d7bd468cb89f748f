use super::*;

fn sample(width: u32, height: u32) -> Picture {
    let pixels = (0..width * height)
        .map(|i| Rgb([i as f32 * 0.1, 1.0 / (1.0 + i as f32), 1e-30 * i as f32]))
        .collect();
    Picture { width, height, pixels }
}

#[test]
fn exr_keeps_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    let mut picture = sample(37, 19);
    picture.pixels[0] = Rgb([f32::MAX, f32::MIN_POSITIVE / 4.0, -0.0]);
    picture.pixels[1] = Rgb([f32::INFINITY, f32::NEG_INFINITY, f32::NAN]);
    write_exr(&path, &picture).unwrap();
    let back = read_exr(&path).unwrap();
    assert_eq!((back.width, back.height), (37, 19));
    for (a, b) in picture.pixels.iter().zip(&back.pixels) {
        assert_eq!(a.0.map(f32::to_bits), b.0.map(f32::to_bits));
    }
    // Again over the old one, and nothing else is left in the folder.
    write_exr(&path, &picture).unwrap();
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn png_is_readable() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.png");
    let pixels = (0..5 * 3).map(|i| [i as u8, 255 - i as u8, 7]).collect();
    let bitmap = Bitmap { width: 5, height: 3, pixels };
    write_png(&path, &bitmap).unwrap();
    let decoder = png::Decoder::new(io::BufReader::new(File::open(&path).unwrap()));
    let mut reader = decoder.read_info().unwrap();
    let mut bytes = vec![0; reader.output_buffer_size().unwrap()];
    let info = reader.next_frame(&mut bytes).unwrap();
    assert_eq!((info.width, info.height, info.color_type), (5, 3, png::ColorType::Rgb));
    assert_eq!(bytes, bitmap.pixels.as_flattened());
}

#[test]
fn damaged_files_are_errors_not_panics() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.exr");
    write_exr(&path, &sample(6, 5)).unwrap();
    let good = fs::read(&path).unwrap();
    for at in 0..good.len() {
        for flip in [0x01, 0xff] {
            let mut bad = good.clone();
            bad[at] ^= flip;
            fs::write(&path, &bad).unwrap();
            let _ = read_exr(&path);
        }
        fs::write(&path, &good[..at]).unwrap();
        assert!(read_exr(&path).is_err(), "cut to {at} bytes");
    }
    fs::write(&path, b"not a picture").unwrap();
    let error = read_exr(&path).unwrap_err().to_string();
    assert!(error.contains("a.exr"), "{error}");
    assert!(matches!(read_exr(&folder.path().join("none.exr")), Err(ImageError::Io { .. })));
}

#[test]
fn what_is_no_file_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let picture = sample(2, 2);
    let refused = write_exr(folder.path(), &picture);
    assert!(matches!(refused, Err(ImageError::NotAFile { .. })), "{refused:?}");
    let empty = write_exr(&folder.path().join("e.exr"), &Picture::black(0, 3));
    assert!(matches!(empty, Err(ImageError::Empty { .. })));
    let nowhere = write_exr(&folder.path().join("no/such/folder.exr"), &picture);
    assert!(matches!(nowhere, Err(ImageError::Io { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}

#[cfg(unix)]
#[test]
fn links_stay_links_and_others_may_read() {
    use std::os::unix::fs::{PermissionsExt, symlink};
    let folder = tempfile::tempdir().unwrap();
    let (file, link) = (folder.path().join("a.exr"), folder.path().join("l.exr"));
    write_exr(&file, &sample(2, 2)).unwrap();
    symlink(&file, &link).unwrap();
    write_exr(&link, &sample(3, 1)).unwrap();
    assert!(fs::symlink_metadata(&link).unwrap().is_symlink());
    assert_eq!(read_exr(&file).unwrap().width, 3);
    // The mode that any new file gets here, whatever the umask.
    let plain = folder.path().join("plain");
    File::create(&plain).unwrap();
    let mode = |p: &Path| fs::metadata(p).unwrap().permissions().mode();
    assert_eq!(mode(&file), mode(&plain));
    assert!(matches!(
        write_exr(Path::new("/dev/null"), &sample(1, 1)),
        Err(ImageError::NotAFile { .. })
    ));
}
