//! Where the walker stands and looks: keys and mouse in, a camera out. No window, no clock.

use crate::action::Way;
use glam::DVec3;
use vlf::Camera;

/// How far the mouse turns the view, radians a pixel.
const TURN: f64 = 0.004;

/// The steepest look up or down, radians; straight up there would be no ahead.
const STEEPEST: f64 = 1.55;

/// The most seconds that one step may take: a long pause (a window moved, a machine asleep) is no
/// long way.
pub const LONGEST_STEP: f64 = 0.25;

/// The speed with the hurry key, in usual speeds.
const HURRY: f64 = 4.0;

/// Which movements are being asked for.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Pressed {
    /// Ahead.
    pub ahead: bool,
    /// Back.
    pub back: bool,
    /// To the left.
    pub left: bool,
    /// To the right.
    pub right: bool,
    /// Along the scene's up.
    pub up: bool,
    /// Against it.
    pub down: bool,
    /// Faster.
    pub hurry: bool,
}

impl Pressed {
    /// A movement begins or ends.
    pub fn set(&mut self, way: Way, on: bool) {
        *match way {
            Way::Ahead => &mut self.ahead,
            Way::Back => &mut self.back,
            Way::Left => &mut self.left,
            Way::Right => &mut self.right,
            Way::Up => &mut self.up,
            Way::Down => &mut self.down,
            Way::Hurry => &mut self.hurry,
        } = on;
    }
}

/// The walker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Walk {
    /// The eye, in the scene's own units.
    eye: DVec3,
    /// Unit vectors: the scene's up, and the level directions that yaw 0 and yaw 90 degrees look in.
    up: DVec3,
    north: DVec3,
    west: DVec3,
    /// Radians, counter-clockwise about `up`.
    yaw: f64,
    /// Radians above the level.
    pitch: f64,
    vfov_deg: f64,
    /// Own units a second.
    speed: f64,
}

impl Walk {
    /// Starts where a camera stands. `speed` is in the scene's own units a second.
    pub fn new(camera: &Camera, speed: f64) -> Walk {
        let up = camera.up.normalize_or(DVec3::Y);
        let forward = (camera.target - camera.eye).normalize_or(up.any_orthonormal_vector());
        let level = forward - up * forward.dot(up);
        let north = level.normalize_or(up.any_orthonormal_vector());
        let pitch = forward.dot(up).clamp(-1.0, 1.0).asin().clamp(-STEEPEST, STEEPEST);
        let west = up.cross(north);
        let (eye, vfov_deg) = (camera.eye, camera.vfov_deg);
        Walk { eye, up, north, west, yaw: 0.0, pitch, vfov_deg, speed }
    }

    /// What the walker sees, as a picture of `width` x `height` pixels.
    pub fn camera(&self, width: u32, height: u32) -> Camera {
        let target = self.eye + self.forward();
        Camera { eye: self.eye, target, up: self.up, vfov_deg: self.vfov_deg, width, height }
    }

    /// Turns by a way of the mouse in pixels; what is under the pointer follows it.
    pub fn turn(&mut self, right: f64, down: f64) {
        self.yaw = (self.yaw + right * TURN) % std::f64::consts::TAU;
        self.pitch = (self.pitch + down * TURN).clamp(-STEEPEST, STEEPEST);
    }

    /// Moves for some seconds; true when the eye moved. `allowed` says how much of a way from a place,
    /// in own units, can be gone.
    pub fn step(
        &mut self,
        pressed: Pressed,
        seconds: f64,
        allowed: &dyn Fn(DVec3, DVec3) -> DVec3,
    ) -> bool {
        let axis = |plus: bool, minus: bool| f64::from(i8::from(plus) - i8::from(minus));
        let way = self.forward() * axis(pressed.ahead, pressed.back)
            + self.right() * axis(pressed.right, pressed.left)
            + self.up * axis(pressed.up, pressed.down);
        let Some(way) = way.try_normalize() else { return false };
        let speed = if pressed.hurry { self.speed * HURRY } else { self.speed };
        let way = allowed(self.eye, way * (speed * seconds.clamp(0.0, LONGEST_STEP)));
        self.eye += way;
        way != DVec3::ZERO
    }

    /// Goes to where a camera stands, and keeps the speed.
    pub fn go_to(&mut self, camera: &Camera) {
        *self = Walk::new(camera, self.speed);
    }

    /// Own units a second.
    pub fn speed(&self) -> f64 {
        self.speed
    }

    /// Changes the speed by notches of the wheel.
    pub fn faster(&mut self, notches: f64) {
        self.speed *= 1.25f64.powf(notches.clamp(-20.0, 20.0));
        self.speed = self.speed.clamp(1e-9, 1e12);
    }

    /// Unit vector straight ahead.
    fn forward(&self) -> DVec3 {
        let level = self.north * self.yaw.cos() + self.west * self.yaw.sin();
        level * self.pitch.cos() + self.up * self.pitch.sin()
    }

    /// Unit vector to the right, level.
    fn right(&self) -> DVec3 {
        self.north * self.yaw.sin() - self.west * self.yaw.cos()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(target: DVec3) -> Camera {
        let eye = DVec3::new(1.0, 2.0, 3.0);
        Camera { eye, target: eye + target, up: DVec3::Y, vfov_deg: 60.0, width: 8, height: 6 }
    }

    fn near(a: DVec3, b: DVec3) {
        assert!((a - b).length() < 1e-9, "{a} is not {b}");
    }

    #[test]
    fn starts_where_the_camera_stands_and_looks_where_it_looks() {
        for target in [-DVec3::Z, DVec3::new(3.0, -1.0, 2.0), DVec3::new(-1.0, 4.0, 0.1)] {
            let walk = Walk::new(&camera(target), 1.0);
            let seen = walk.camera(8, 6);
            near(seen.eye, DVec3::new(1.0, 2.0, 3.0));
            near(seen.target - seen.eye, target.normalize());
        }
    }

    #[test]
    fn looking_down_minus_z_right_is_plus_x() {
        let mut walk = Walk::new(&camera(-DVec3::Z), 4.0);
        assert!(walk.step(Pressed { right: true, ..Pressed::default() }, 0.25, &|_, way| way));
        near(walk.eye, DVec3::new(2.0, 2.0, 3.0));
        assert!(walk.step(
            Pressed { ahead: true, hurry: true, ..Pressed::default() },
            0.25,
            &|_, way| way
        ));
        near(walk.eye, DVec3::new(2.0, 2.0, -1.0));
        assert!(walk.step(Pressed { down: true, ..Pressed::default() }, 9.0, &|_, way| way));
        near(walk.eye, DVec3::new(2.0, 1.0, -1.0));
        assert!(!walk.step(
            Pressed { up: true, down: true, ..Pressed::default() },
            9.0,
            &|_, way| way
        ));
        assert!(!walk.step(Pressed { hurry: true, ..Pressed::default() }, 1.0, &|_, way| way));
    }

    #[test]
    fn the_scene_follows_the_dragging_pointer() {
        let mut walk = Walk::new(&camera(-DVec3::Z), 1.0);
        // To drag the scene to the right is to look to the left, to drag it down is to look up.
        walk.turn(100.0, 50.0);
        let ahead = walk.forward();
        assert!(ahead.x < 0.0 && ahead.y > 0.0 && ahead.z < 0.0, "{ahead}");
        assert!((ahead.length() - 1.0).abs() < 1e-12);
        // However far, the look stays short of the zenith.
        walk.turn(0.0, 1e6);
        let seen = walk.camera(8, 6);
        assert!((seen.target - seen.eye).cross(seen.up).length() > 0.01);
    }

    #[test]
    fn odd_cameras_give_finite_walks() {
        for (target, up) in [(DVec3::Y, DVec3::Y), (DVec3::ZERO, DVec3::Y), (DVec3::X, DVec3::ZERO)]
        {
            let mut walk = Walk::new(&Camera { up, ..camera(target) }, 1.0);
            walk.faster(1e9);
            walk.turn(3.0, -4.0);
            assert!(walk.camera(8, 6).target.is_finite() && walk.speed.is_finite());
        }
    }
}
