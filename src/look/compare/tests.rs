use super::*;

fn picture(width: u32, height: u32, value: impl Fn(u32) -> [f32; 3]) -> Picture {
    Picture { width, height, pixels: (0..width * height).map(|i| Rgb(value(i))).collect() }
}

fn near(a: f64, b: f64) {
    assert!((a - b).abs() <= 1e-9 * b.abs(), "{a} is not {b}");
}

#[test]
fn numbers_worked_out_by_hand() {
    // Reference 1, 2, 3 everywhere: mean 2, e = 0.04. The picture is off by +0.1 in red alone.
    let reference = picture(16, 8, |_| [1.0, 2.0, 3.0]);
    let test = picture(16, 8, |_| [1.5, 2.0, 3.0]);
    let c = compare(&test, &reference).unwrap();
    near(c.eps, 0.04);
    near(c.rmse, (0.25f64 / 3.0).sqrt());
    near(c.relmse, 0.25 / 1.04 / 3.0);
    near(c.relmse_trimmed, c.relmse);
    near(c.worst, c.relmse.sqrt());
    near(c.worst_of_brightest, 0.5 / 9.04f64.sqrt());
    near(c.block8.unwrap(), c.relmse);
    near(c.ratio, 6.5 / 6.0);
    near(c.ratio_rgb[0], 1.5);
    near(c.ratio_rgb[2], 1.0);
    assert_eq!(c.nonfinite_pixels, 0);
    let line = c.to_string();
    assert!(line.starts_with("RMSE 0.288675 relMSE 0.080128") && !line.contains('\n'), "{line}");
}

#[test]
fn one_bad_pixel_is_trimmed_and_noise_averages_out_of_blocks() {
    let reference = picture(40, 30, |_| [1.0; 3]);
    let e = 1.0 + 0.01;
    let firefly = picture(40, 30, |i| [if i == 77 { 11.0 } else { 1.0 }; 3]);
    let c = compare(&firefly, &reference).unwrap();
    near(c.relmse, 100.0 / e / 1200.0);
    assert_eq!(c.relmse_trimmed, 0.0);
    let chequer = picture(40, 30, |i| [if (i + i / 40) % 2 == 0 { 1.5 } else { 0.5 }; 3]);
    let c = compare(&chequer, &reference).unwrap();
    near(c.relmse, 0.25 / e);
    assert_eq!(c.block8, Some(0.0));
}

#[test]
fn odd_values_are_counted_and_refused_in_the_reference() {
    let reference = picture(2, 2, |_| [1.0; 3]);
    let test = picture(2, 2, |i| [if i == 0 { f32::NAN } else { 1.0 }, 1.0, 1.0]);
    let c = compare(&test, &reference).unwrap();
    assert_eq!((c.nonfinite_pixels, c.block8), (1, None));
    near(c.ratio, 11.0 / 12.0);
    assert_eq!(compare(&reference, &test), Err(CompareError::Reference { pixels: 1 }));
    let small = picture(2, 1, |_| [1.0; 3]);
    assert!(matches!(compare(&small, &reference), Err(CompareError::Sizes { .. })));
    assert_eq!(
        compare(&picture(0, 0, |_| [0.0; 3]), &picture(0, 0, |_| [0.0; 3])),
        Err(CompareError::Empty)
    );
}

#[test]
fn the_panel_shows_too_bright_in_red_and_too_dark_in_blue() {
    let reference = picture(3, 1, |_| [1.0; 3]);
    let test = picture(3, 1, |i| [i as f32; 3]);
    let panel = difference_picture(&test, &reference, 0.0).unwrap();
    assert_eq!((panel.width, panel.height), (3 * 3 + 8, 1));
    assert_eq!(panel.pixels[14], [0, 0, 204]);
    assert_eq!(panel.pixels[15], [255, 255, 255]);
    assert_eq!(panel.pixels[16], [204, 0, 0]);
    assert_eq!(panel.pixels[1], panel.pixels[3 + 4]);
}
