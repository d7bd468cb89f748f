//! Walls stop the walker, who slides along them.

use glam::{DVec3, Vec3};
use vlf::{Scene, Visible};

/// How near to a wall the eye may come, in the fitted scene's units.
const NEAREST: f64 = 0.02;

/// Walls that one step can slide along: two that meet, and the floor.
const SLIDES: usize = 3;

/// How much of a way from a place, both in the scene's own units, can be gone. What is left of a way
/// into a wall is gone along it. One ray along the way is what is asked, so things as thin as a table's
/// leg stop nobody who passes beside them.
pub fn slide(scene: &Scene, visible: &Visible, from: DVec3, way: DVec3) -> DVec3 {
    let radius = scene.fit.radius;
    let mut gone = DVec3::ZERO;
    let mut left = way / radius;
    for _ in 0..SLIDES {
        let length = left.length();
        if length < 1e-9 {
            break;
        }
        let dir = left / length;
        let eye = scene.fit.to_unit(from + gone * radius);
        let Some(hit) = visible.nearest(eye, dir.as_vec3(), 0.0) else {
            return (gone + left) * radius;
        };
        let normal = scene.surface(hit.surface).normal.as_dvec3();
        // The part of the way into the wall, and the room there is before it.
        let into = normal * -normal.dot(dir).signum();
        let steep = -into.dot(dir);
        let room = f64::from(hit.distance) * steep - NEAREST;
        if room >= length * steep {
            return (gone + left) * radius;
        }
        let step = dir * (room.max(0.0) / steep.max(1e-9)).min(length);
        gone += step;
        left -= step;
        left += into * -into.dot(left);
    }
    gone * radius
}

/// Whether an eye, in the fitted scene's units, is where a walker can be.
pub fn is_open(visible: &Visible, eye: Vec3) -> bool {
    visible.touching(eye).is_none() && !visible.inside_a_solid(eye)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A closed box.
    fn furnace() -> Scene {
        let scenes = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../scenes");
        Scene::open(&scenes.join("furnace/furnace.obj")).unwrap().0
    }

    #[test]
    fn nobody_leaves_a_closed_room() {
        let scene = furnace();
        let visible = Visible::new(&scene);
        let radius = scene.fit.radius;
        let start = scene.fit.to_own(Vec3::new(0.01, 0.02, 0.03));
        let half = visible.nearest(scene.fit.to_unit(start), Vec3::X, 0.0).unwrap().distance + 0.01;
        let mut eye = start;
        let mut touched = false;
        for i in 0..5000 {
            let golden = 2.399_963 * f64::from(i);
            let way = DVec3::new(golden.cos(), (1.7 * golden).sin(), golden.sin()) * 0.9 * radius;
            let gone = slide(&scene, &visible, eye, way);
            assert!(gone.length() <= way.length() * (1.0 + 1e-9));
            touched |= gone != way;
            eye += gone;
            let farthest = scene.fit.to_unit(eye).abs().max_element();
            assert!(farthest < half - 0.5 * NEAREST as f32, "{farthest} of {half} after {i} steps");
        }
        assert!(touched);
    }

    #[test]
    fn along_a_wall_goes_the_rest_of_the_way() {
        let scene = furnace();
        let visible = Visible::new(&scene);
        let start = scene.fit.to_own(Vec3::ZERO);
        let gone = slide(&scene, &visible, start, DVec3::new(1.0, 0.0, -10.0) * scene.fit.radius);
        let far = gone / scene.fit.radius;
        assert!(far.x > 0.4 && far.z < -0.4 && far.z > -1.0 && far.y.abs() < 1e-9, "{far}");
    }
}
