//! The pinhole camera, in the scene's own units, its JSON file, and its rays in the unit ball.

use super::Fit;
use crate::format::text::inert;
use fearless_simd::{Simd, f64x8, prelude::*};
use glam::{DVec3, Vec3};
use serde::{Deserialize, Serialize};
use std::io::{self, Read};
use std::path::{Path, PathBuf};

/// Most pixels along a row or column.
const MOST_EDGE: u32 = 16384;

/// Most pixels of a picture.
const MOST_PIXELS: u64 = 1 << 28;

/// Most bytes of a camera file.
const MOST_BYTES: u64 = 1 << 20;

/// A pinhole camera. The picture is `width` x `height` pixels; `vfov_deg` is the full vertical angle.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Camera {
    /// Where the eye is, in the scene's own units.
    pub eye: DVec3,
    /// What it looks at.
    pub target: DVec3,
    /// Which way is up in the picture; need not be perpendicular to the view.
    pub up: DVec3,
    /// Vertical field of view in degrees, in (0, 180).
    pub vfov_deg: f64,
    /// Pixels along a row.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// Why a camera was refused.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CameraError {
    /// The file could not be read.
    #[error("{}: cannot be read: {source}; give the path of a camera file", path.display())]
    Read {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: io::Error,
    },
    /// Not JSON, or not a camera's.
    #[error(
        "not a camera: {}; write {{\"eye\":[x,y,z],\"target\":[x,y,z],\"up\":[x,y,z],\
         \"vfov_deg\":d,\"width\":w,\"height\":h}}",
        inert(&.0.to_string(), 200)
    )]
    Json(#[from] serde_json::Error),
    /// A field whose value cannot be.
    #[error("camera field `{field}` is {value}: {message}")]
    Field {
        /// The field.
        field: &'static str,
        /// Its value.
        value: String,
        /// What it must be.
        message: &'static str,
    },
    /// Any of the others, in a file.
    #[error("{}: {source}", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What is wrong with its contents.
        source: Box<CameraError>,
    },
}

impl Camera {
    /// Reads a camera from JSON and checks it. Fields that a camera does not have are left alone.
    ///
    /// # Errors
    /// [`CameraError::Json`], or [`CameraError::Field`] as [`Camera::check`] finds it.
    pub fn from_json(text: &str) -> Result<Camera, CameraError> {
        let camera: Camera = serde_json::from_str(text)?;
        camera.check()?;
        Ok(camera)
    }

    /// Reads a camera file; see [`Camera::from_json`].
    ///
    /// # Errors
    /// [`CameraError::Read`] or [`CameraError::File`].
    pub fn open(path: &Path) -> Result<Camera, CameraError> {
        let mut text = String::new();
        // A longer file is cut and then no JSON; devices that never end are cut as well.
        std::fs::File::open(path)
            .and_then(|file| file.take(MOST_BYTES).read_to_string(&mut text))
            .map_err(|source| CameraError::Read { path: path.to_owned(), source })?;
        Camera::from_json(&text)
            .map_err(|e| CameraError::File { path: path.to_owned(), source: Box::new(e) })
    }

    /// Checks that the camera can take a picture: all numbers finite, the eye away from the target,
    /// `up` across the view, the angle in (0, 180), 1 to 16384 pixels a side and at most 2^28 in all.
    ///
    /// # Errors
    /// [`CameraError::Field`] with the first field that fails.
    pub fn check(&self) -> Result<(), CameraError> {
        let require = |holds: bool, field, value: String, message| {
            if holds { Ok(()) } else { Err(CameraError::Field { field, value, message }) }
        };
        for (field, v) in [("eye", self.eye), ("target", self.target), ("up", self.up)] {
            let bounded = v.abs().max_element() <= 1e30 && v.is_finite();
            require(bounded, field, v.to_string(), "every coordinate must be finite")?;
        }
        let view = self.target - self.eye;
        let apart = view.length() > 1e-12 * self.eye.length() && view.length() > 0.0;
        require(apart, "target", self.target.to_string(), "it must not be where the eye is")?;
        let up = self.up.normalize_or_zero();
        let message = "it must not be zero, nor along the view from `eye` to `target`";
        let across = up.cross(view.normalize_or_zero()).length() > 1e-6;
        require(across, "up", self.up.to_string(), message)?;
        let angle = self.vfov_deg > 0.0 && self.vfov_deg < 180.0;
        let message = "the vertical angle must lie between 0 and 180 degrees";
        require(angle, "vfov_deg", self.vfov_deg.to_string(), message)?;
        for (field, n) in [("width", self.width), ("height", self.height)] {
            let fits = (1..=MOST_EDGE).contains(&n);
            require(fits, field, n.to_string(), "it must lie between 1 and 16384 pixels")?;
        }
        let pixels = u64::from(self.width) * u64::from(self.height);
        let value = format!("{} x {}", self.width, self.height);
        let message = "a picture may have at most 268435456 pixels";
        require(pixels <= MOST_PIXELS, "width x height", value, message)
    }

    /// The camera in the unit ball of a fitted scene.
    pub fn view(&self, fit: &Fit) -> View {
        let [forward, right, _] = self.axes();
        let pixel = 2.0 * (0.5 * self.vfov_deg.to_radians()).tan() / f64::from(self.height);
        let across = right * pixel;
        let down = forward.cross(right) * pixel;
        let middle = [self.width, self.height].map(|n| 0.5 * f64::from(n));
        let corner = forward - across * middle[0] - down * middle[1];
        View { origin: fit.to_unit(self.eye), corner, across, down }
    }

    /// The camera as one that sees all around, in the unit ball of a fitted scene.
    pub fn panorama(&self, fit: &Fit) -> Panorama {
        let [forward, right, _] = self.axes();
        let up = self.up.normalize_or(right.cross(forward));
        let size = [self.width, self.height].map(f64::from);
        Panorama { origin: fit.to_unit(self.eye), ahead: up.cross(right), right, up, size }
    }

    /// The six square cameras of a cube around the eye, with what each is called: `front` looks level, as
    /// `up` has it, towards the target. Seen from inside, `right`, `back` and `left` follow it clockwise
    /// with `up` upwards; below `up` and above `down` is `front`. Each has `height` pixels a side.
    pub fn cube(&self) -> [(&'static str, Camera); 6] {
        let [forward, right, _] = self.axes();
        let up = self.up.normalize_or(right.cross(forward));
        let ahead = up.cross(right);
        let face = |towards: DVec3, up: DVec3| Camera {
            target: self.eye + towards,
            up,
            vfov_deg: 90.0,
            width: self.height,
            ..*self
        };
        [
            ("front", face(ahead, up)),
            ("right", face(right, up)),
            ("back", face(-ahead, up)),
            ("left", face(-right, up)),
            ("up", face(up, -ahead)),
            ("down", face(-up, ahead)),
        ]
    }

    /// Unit vectors: towards the target, to the right in the picture, and up in it.
    fn axes(&self) -> [DVec3; 3] {
        let forward = (self.target - self.eye).normalize_or(-DVec3::Z);
        let right = forward.cross(self.up).normalize_or(forward.any_orthonormal_vector());
        [forward, right, right.cross(forward)]
    }
}

/// A camera fitted to the unit ball: from places in the picture to rays.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct View {
    /// The eye, in the fitted scene's units; it may be outside the ball.
    pub origin: Vec3,
    /// Towards the top left corner of the picture; at least as long as 1.
    pub corner: DVec3,
    /// One pixel to the right.
    pub across: DVec3,
    /// One pixel down.
    pub down: DVec3,
}

impl View {
    /// The ray through a place in the picture, in pixels from its top left corner: the middle of the
    /// first pixel is at (0.5, 0.5). Origin and unit direction, in the unit ball.
    pub fn ray(&self, px: f64, py: f64) -> (Vec3, Vec3) {
        let direction = self.corner + self.across * px + self.down * py;
        (self.origin, direction.normalize().as_vec3())
    }

    /// The same view moved by so many pixels to the right and down in its picture.
    pub fn moved(&self, right: f64, down: f64) -> View {
        View { corner: self.corner + self.across * right + self.down * down, ..*self }
    }

    /// The directions of eight rays, each as that of [`View::ray`], before they are rounded.
    #[inline(always)]
    pub fn eight<S: Simd>(&self, simd: S, px: f64x8<S>, py: f64x8<S>) -> [f64x8<S>; 3] {
        let View { corner, across, down, .. } = self;
        let x = px * across.x + corner.x + py * down.x;
        let y = px * across.y + corner.y + py * down.y;
        let z = px * across.z + corner.z + py * down.z;
        let scale = f64x8::splat(simd, 1.0) / (x * x + y * y + z * z).sqrt();
        [x * scale, y * scale, z * scale]
    }
}

/// A camera that sees all around: columns are angles about `up`, rows angles from it (equirectangular).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Panorama {
    /// The eye, in the fitted scene's units.
    pub origin: Vec3,
    /// Level towards what the camera looks at: the middle of the picture.
    ahead: DVec3,
    right: DVec3,
    up: DVec3,
    /// Width and height in pixels.
    size: [f64; 2],
}

impl Panorama {
    /// The ray through a place in the picture, as [`View::ray`].
    pub fn ray(&self, px: f64, py: f64) -> (Vec3, Vec3) {
        let (sin, cos) = ((px / self.size[0] - 0.5) * std::f64::consts::TAU).sin_cos();
        let (rise, level) = ((0.5 - py / self.size[1]) * std::f64::consts::PI).sin_cos();
        let direction = (self.ahead * cos + self.right * sin) * level + self.up * rise;
        (self.origin, direction.as_vec3().normalize())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const GOOD: &str = r#"{"eye":[0,0,5],"target":[0,0,0],"up":[0,1,0],"vfov_deg":90,
        "width":4,"height":2,"scene":"unknown fields do no harm"}"#;

    #[test]
    fn image_right_is_plus_x_looking_down_minus_z() {
        let fit = Fit { centre: DVec3::new(0.0, 0.0, 1.0), radius: 2.0 };
        let view = Camera::from_json(GOOD).unwrap().view(&fit);
        let (origin, middle) = view.ray(2.0, 1.0);
        assert_eq!(origin, Vec3::new(0.0, 0.0, 2.0));
        assert!(middle.distance(-Vec3::Z) < 1e-6);
        // The top middle is 45 degrees up; the right edge twice as far out.
        assert!(view.ray(2.0, 0.0).1.distance(Vec3::new(0.0, 1.0, -1.0).normalize()) < 1e-6);
        assert!(view.ray(4.0, 1.0).1.distance(Vec3::new(2.0, 0.0, -1.0).normalize()) < 1e-6);
    }

    #[test]
    fn a_panorama_looks_ahead_in_its_middle_and_clockwise_to_its_right() {
        let fit = Fit { centre: DVec3::ZERO, radius: 1.0 };
        let text = GOOD.replace("[0,0,0]", "[0,3,0]").replace("\"width\":4", "\"width\":8");
        let all_around = Camera::from_json(&text).unwrap().panorama(&fit);
        let near = |x, y, to: Vec3| {
            let dir = all_around.ray(x, y).1;
            assert!(dir.distance(to) < 1e-6, "({x}, {y}) looks to {dir}, not {to}");
        };
        // Level, though the camera looks up.
        near(4.0, 1.0, -Vec3::Z);
        near(6.0, 1.0, Vec3::X);
        near(2.0, 1.0, -Vec3::X);
        near(0.0, 1.0, Vec3::Z);
        near(8.0, 1.0, Vec3::Z);
        near(1.0, 0.0, Vec3::Y);
        near(4.0, 1.5, Vec3::new(0.0, -1.0, -1.0).normalize());
    }

    #[test]
    fn the_faces_of_a_cube_meet_at_their_edges() {
        let fit = Fit { centre: DVec3::ZERO, radius: 1.0 };
        let faces = Camera::from_json(GOOD).unwrap().cube();
        let face = |name: &str| faces.iter().find(|f| f.0 == name).unwrap().1.view(&fit);
        let same = |one: (&str, f64, f64), two: (&str, f64, f64)| {
            let (a, b) = (face(one.0).ray(one.1, one.2).1, face(two.0).ray(two.1, two.2).1);
            assert!(a.distance(b) < 1e-6, "{one:?} sees {a}, {two:?} {b}");
        };
        let all = ["front", "right", "back", "left"];
        for (one, next) in all.iter().zip(all.iter().cycle().skip(1)) {
            same((one, 2.0, 0.5), (next, 0.0, 0.5));
        }
        // Below the upper face and above the lower is the front.
        same(("up", 0.7, 2.0), ("front", 0.7, 0.0));
        same(("down", 0.7, 0.0), ("front", 0.7, 2.0));
        assert!(face("front").ray(1.0, 1.0).1.distance(-Vec3::Z) < 1e-6);
    }

    #[test]
    fn a_bad_camera_names_its_field_and_value() {
        let cases = [
            ("\"vfov_deg\":90", "\"vfov_deg\":180", "`vfov_deg` is 180"),
            ("\"vfov_deg\":90", "\"vfov_deg\":0", "`vfov_deg` is 0"),
            ("[0,0,0]", "[0,0,5]", "`target` is [0, 0, 5]"),
            ("[0,1,0]", "[0,0,2]", "`up` is [0, 0, 2]"),
            ("[0,1,0]", "[0,0,0]", "`up` is [0, 0, 0]"),
            ("[0,1,0]", "[0,1e300,0]", "`up` is"),
            ("\"width\":4", "\"width\":0", "`width` is 0"),
            ("\"height\":2", "\"height\":16385", "`height` is 16385"),
            ("\"width\":4,\"height\":2", "\"width\":16384,\"height\":16385", "`height`"),
            ("[0,0,5]", "[0,0,1e999]", "not a camera"),
            ("[0,0,5]", "[0,0]", "not a camera"),
            ("\"eye\"", "\"I\"", "missing field `eye`"),
            ("\"width\":4", "\"width\":-4", "not a camera"),
        ];
        for (from, to, message) in cases {
            let text = GOOD.replace("\n        ", "").replace(from, to);
            let error = Camera::from_json(&text).unwrap_err().to_string();
            assert!(error.contains(message), "{to}: {error}");
        }
    }
}
