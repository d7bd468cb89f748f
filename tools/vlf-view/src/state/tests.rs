use super::*;
use crate::paint::{Spare, paint};
use crate::testing::{opening, pack};
use std::sync::atomic::AtomicBool;
use vlf::look::render::method;

/// An opened pack, and a walk through it.
fn begun() -> (Source, Walkthrough) {
    let (_folder, pack) = pack();
    let source = opening(&pack).open().unwrap();
    let state = Walkthrough::new(source.start, source.speed, Method::Field, None);
    (source, state)
}

/// Does what there is to do, so many seconds after the last time.
fn frame(state: &mut Walkthrough, source: &Source, seconds: f64) -> Option<Job> {
    let job = state.next(source, seconds, (32, 24))?;
    let frame = paint(source, &job, &AtomicBool::new(false), &mut Spare::default()).unwrap();
    state.took(&job, frame);
    Some(job)
}

/// Does all there is to do.
fn rest(state: &mut Walkthrough, source: &Source) -> Vec<Job> {
    std::iter::from_fn(|| frame(state, source, 0.01)).collect()
}

fn press(state: &mut Walkthrough, code: &str) -> Option<Wish> {
    let wish = state.key(code, "", true, false);
    assert_eq!(state.key(code, "", false, false), None);
    wish
}

fn shot(job: &Job) -> Shot {
    match job {
        Job::Take(shot, _) => *shot,
        Job::Develop(taken, _) => taken.shot,
    }
}

#[test]
fn at_rest_the_picture_becomes_what_render_makes() {
    let (source, mut state) = begun();
    let jobs = rest(&mut state, &source);
    assert_eq!(shot(&jobs[0]).method, Method::Trace, "maps are waited for");
    assert!(jobs[1..].iter().all(|job| shot(job).method == Method::Field) && state.is_done());
    let Source { field, visible, start, .. } = &source;
    let how = (vlf::Method::Field, vlf::look::render::Options::default());
    let camera = Camera { width: 32, height: 24, ..state.camera() };
    assert!(camera.eye == start.eye);
    let expected = method::take(field, visible, &camera, how, &|_| ()).unwrap();
    assert!(state.shown().unwrap().taken.picture == expected);
    assert!(expected.pixels.iter().any(|p| !p.is_black()));
}

#[test]
fn keys_walk_for_as_long_as_they_are_down() {
    let (source, mut state) = begun();
    rest(&mut state, &source);
    let before = state.camera();
    state.key("KeyW", "w", true, false);
    let job = frame(&mut state, &source, 0.1).unwrap();
    assert_eq!(shot(&job).pass.samples, 1);
    let gone = (state.camera().eye - before.eye).length();
    assert!((gone - 0.1 * source.speed).abs() < 1e-9, "{gone}");
    assert_eq!(shot(&job).camera.eye, state.camera().eye);
    state.key("KeyW", "w", false, false);
    rest(&mut state, &source);
    assert!(state.is_done() && (state.camera().eye - before.eye).length() == gone);
    assert_eq!(press(&mut state, "KeyR"), None);
    rest(&mut state, &source);
    assert_eq!(state.camera().eye, before.eye);
}

#[test]
fn refinement_gives_way_to_motion_and_motion_to_nothing() {
    let (source, mut state) = begun();
    let moving = state.next(&source, 0.0, (32, 24)).unwrap();
    state.drag(5.0, 0.0);
    assert!(!state.is_overtaken(), "no frame would ever be shown while the mouse moves");
    let taken = paint(&source, &moving, &AtomicBool::new(false), &mut Spare::default()).unwrap();
    state.took(&moving, taken);
    frame(&mut state, &source, 0.01);
    let refining = state.next(&source, 0.01, (32, 24)).unwrap();
    assert!(!state.is_overtaken());
    state.drag(5.0, 0.0);
    assert!(state.is_overtaken());
    assert!(paint(&source, &refining, &AtomicBool::new(true), &mut Spare::default()).is_none());
    let job = state.next(&source, 0.01, (32, 24)).unwrap();
    assert_eq!(shot(&job).camera.target, state.camera().target);
}

#[test]
fn the_look_changes_without_a_new_picture() {
    let (source, mut state) = begun();
    rest(&mut state, &source);
    // The first exposure was that of a coarse picture.
    press(&mut state, "KeyX");
    rest(&mut state, &source);
    let before = state.shown().unwrap().clone();
    press(&mut state, "Equal");
    let jobs = rest(&mut state, &source);
    assert!(matches!(jobs[..], [Job::Develop(..)]), "{}", jobs.len());
    let after = state.shown().unwrap();
    assert!(after.taken.picture == before.taken.picture && after.bitmap != before.bitmap);
    assert_eq!(after.look.exposure.unwrap(), before.look.exposure.unwrap() + 0.5);
    press(&mut state, "KeyX");
    rest(&mut state, &source);
    assert!(state.shown().unwrap().bitmap == before.bitmap);
    for curve in [Curve::Reinhard, Curve::Plain, Curve::Shoulder] {
        press(&mut state, "KeyT");
        rest(&mut state, &source);
        assert_eq!(state.shown().unwrap().look.curve, curve);
    }
}

#[test]
fn methods_take_turns_and_the_difference_is_that_of_the_two() {
    let (source, mut state) = begun();
    let mut taken = Vec::new();
    for method in [Method::Field, Method::Trace, Method::Difference] {
        rest(&mut state, &source);
        assert_eq!(state.shown().unwrap().taken.shot.method, method);
        taken.push(state.shown().unwrap().taken.clone());
        press(&mut state, "KeyM");
    }
    let pixels = |i: usize| taken[i].picture.pixels.iter();
    for ((a, b), d) in pixels(0).zip(pixels(1)).zip(pixels(2)) {
        assert_eq!(d.0, [0, 1, 2].map(|c| (a.0[c] - b.0[c]).abs()));
    }
}

#[test]
fn views_are_saved_and_recalled() {
    let (source, state) = begun();
    let folder = tempfile::tempdir().unwrap();
    let mut state = state.with_views(Views::of(&folder.path().join("a.vlf")));
    rest(&mut state, &source);
    state.key("Digit4", "$", true, true);
    let saved = state.camera();
    state.drag(100.0, 10.0);
    state.key("KeyD", "", true, false);
    frame(&mut state, &source, 0.2);
    state.key("KeyD", "", false, false);
    assert_ne!(state.camera(), saved);
    press(&mut state, "Digit4");
    rest(&mut state, &source);
    assert!((state.camera().target - saved.target).length() < 1e-12);
    assert_eq!(state.camera().eye, saved.eye);
    let Some(Wish::Copy(text)) = press(&mut state, "KeyJ") else { panic!("no camera") };
    assert_eq!(Camera::from_json(&text).unwrap(), state.camera());
}

#[test]
fn the_help_is_left_before_the_window_is() {
    let (source, mut state) = begun();
    let news = News::default();
    state.key("Minus", "?", true, false);
    assert!(state.lines(&source, &news).iter().any(|line| line.contains("full screen")));
    assert_eq!(press(&mut state, "Escape"), None);
    assert!(state.lines(&source, &news).is_empty());
    assert_eq!(press(&mut state, "Escape"), Some(Wish::Leave));
    rest(&mut state, &source);
    press(&mut state, "KeyI");
    let figures = state.lines(&source, &news).join("\n");
    for what in [" ms ", "32 x 24", "field", "cache", "bounce"] {
        assert!(figures.contains(what), "no {what} in {figures}");
    }
}

#[test]
fn whatever_is_pressed_there_is_a_camera() {
    let (source, mut state) = begun();
    let keys = ["KeyW", "KeyD", "KeyE", "ShiftLeft", "KeyK", "Digit1", "KeyR", "F1", "Bogus", ""];
    let mut random = 1u32;
    for i in 0..3000 {
        random = random.wrapping_mul(747_796_405).wrapping_add(2_891_336_453);
        let at = random as usize >> 8;
        state.key(keys[at % keys.len()], "x", at & 1 << 10 != 0, false);
        state.drag((at % 1000) as f64 - 500.0, (at % 77) as f64 - 38.0);
        state.wheel(f64::from(random % 9) - 4.0);
        let size = [(32, 24), (1, 1), (16_384, 1), (7, 900)][at % 4];
        let seconds = [0.0, 0.02, 1e9, -1.0][at / 4 % 4];
        let job = state.next(&source, seconds, size);
        if let Some(job) = &job {
            shot(job).taken_by().check().unwrap();
        }
        if i % 100 == 0 {
            state.another_source();
        }
    }
    let times: Vec<f64> = state.recorded().iter().map(|v| v.time).collect();
    assert!(times.is_sorted() && times.len() > 100);
    vlf::look::path::CameraPath::new(state.recorded().to_vec()).unwrap();
}
