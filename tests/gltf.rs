//! A glTF scene is lit as it should be, and the program takes it as it takes an OBJ.

mod common;

use assert_cmd::Command;
use common::{Baked, parameters};
use glam::{DQuat, DVec3};
use serde_json::{Value, json};
use std::f64::consts::{FRAC_PI_2, PI};
use std::fs;
use std::path::Path;
use tempfile::TempDir;
use vlf::{Camera, Rgb, Scene};

/// Corners and triangles of a square of edge 2 in the plane z = 1, facing the origin.
fn wall() -> Vec<u8> {
    let corners = [[-1.0f32, -1.0, 1.0], [-1.0, 1.0, 1.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]];
    let mut bytes: Vec<u8> = corners.as_flattened().iter().flat_map(|c| c.to_le_bytes()).collect();
    bytes.extend([0u16, 1, 2, 0, 2, 3].iter().flat_map(|k| k.to_le_bytes()));
    bytes
}

/// A closed room: one wall placed six times, twice as large as it is stored, and a camera in it. Every wall
/// emits 1, a fourth of it times a strength of 4, and reflects 0.5.
fn furnace() -> Value {
    let turns = [
        DQuat::IDENTITY,
        DQuat::from_rotation_y(PI),
        DQuat::from_rotation_y(FRAC_PI_2),
        DQuat::from_rotation_y(-FRAC_PI_2),
        DQuat::from_rotation_x(FRAC_PI_2),
        DQuat::from_rotation_x(-FRAC_PI_2),
    ];
    let wall = |turn: &DQuat| json!({"mesh": 0, "rotation": turn.to_array()});
    let mut nodes: Vec<Value> = turns.iter().map(wall).collect();
    nodes.push(json!({"name": "from the corner", "camera": 0, "translation": [0.5, 0, 0.25]}));
    nodes.push(json!({"children": [0, 1, 2, 3, 4, 5, 6], "scale": [2, 2, 2]}));
    json!({
        "asset": {"version": "2.0"},
        "scene": 0, "scenes": [{"nodes": [7]}], "nodes": nodes,
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "material": 0}]}],
        "materials": [{
            "name": "wall", "emissiveFactor": [0.25, 0.25, 0.25],
            "extensions": {"KHR_materials_emissive_strength": {"emissiveStrength": 4}},
            "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1], "metallicFactor": 0},
        }],
        "extensionsUsed": ["KHR_materials_emissive_strength"],
        "cameras": [{"type": "perspective", "perspective": {"yfov": 1, "znear": 0.1}}],
        "buffers": [{"uri": "walls.bin", "byteLength": 60}],
        "bufferViews": [
            {"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 12}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3",
             "min": [-1, -1, 1], "max": [1, 1, 1]},
            {"bufferView": 1, "componentType": 5123, "count": 6, "type": "SCALAR"}],
    })
}

/// A folder with the room in it.
fn folder() -> TempDir {
    let folder = TempDir::new().unwrap();
    fs::write(folder.path().join("room.gltf"), furnace().to_string()).unwrap();
    fs::write(folder.path().join("walls.bin"), wall()).unwrap();
    folder
}

/// Were a wall turned, moved or lit otherwise than the file says, light would stain another or escape.
#[test]
fn a_furnace_of_one_wall_placed_six_times_is_two_everywhere() {
    let folder = folder();
    let (scene, report) = Scene::open(&folder.path().join("room.gltf")).unwrap();
    assert_eq!(report.notes, []);
    assert_eq!(scene.surfaces.len(), 6);
    let baked = Baked::new(&scene, &vlf::Parameters { cycles: None, ..parameters(129, 64, 1) });
    for sides in baked.open().total.chunks_exact(2) {
        for c in sides[0].0 {
            assert!((f64::from(c) - 2.0).abs() < 2e-3, "{sides:?}");
        }
        assert_eq!(sides[1], Rgb::BLACK, "light outside the room");
    }
}

/// Runs `vlf bake SCENE -o room.field`, small.
fn bake(folder: &Path, scene: &str) -> (Option<i32>, String) {
    let mut command = Command::new(env!("CARGO_BIN_EXE_vlf"));
    let size = ["--directions", "33", "--resolution", "32", "--cycles", "1", "--quality", "draft"];
    let run = command.current_dir(folder).args(["bake", scene, "-o", "room.field"]).args(size);
    let output = run.output().unwrap();
    (output.status.code(), String::from_utf8(output.stderr).unwrap())
}

#[test]
fn the_cameras_of_a_file_lie_beside_the_field_as_saved_views() {
    let folder = folder();
    let (code, said) = bake(folder.path(), "room.gltf");
    assert_eq!(code, Some(0), "{said}");
    let path = folder.path().join("room.views.json");
    let views: Value = serde_json::from_str(&fs::read_to_string(&path).unwrap()).unwrap();
    let camera = Camera::from_json(&views["1"].to_string()).unwrap();
    assert!(camera.eye.distance(DVec3::new(1.0, 0.0, 0.5)) < 1e-6, "{camera:?}");
    assert!((camera.target - camera.eye).normalize().distance(DVec3::NEG_Z) < 1e-6, "{camera:?}");
    // What the user saved since is not replaced.
    fs::write(&path, "mine").unwrap();
    fs::remove_dir_all(folder.path().join("room.field")).unwrap();
    assert_eq!(bake(folder.path(), "room.gltf").0, Some(0));
    assert_eq!(fs::read_to_string(&path).unwrap(), "mine");
}

#[test]
fn a_file_without_its_buffer_is_refused_and_leaves_nothing() {
    let folder = folder();
    fs::remove_file(folder.path().join("walls.bin")).unwrap();
    let (code, said) = bake(folder.path(), "room.gltf");
    assert_eq!(code, Some(4), "{said}");
    assert!(said.contains("room.gltf: buffer `walls.bin` cannot be read"), "{said}");
    assert!(!folder.path().join("room.field").exists());
}
