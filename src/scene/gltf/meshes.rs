//! Nodes and their meshes to triangles in the scene's own metres.

use super::buffers::Buffers;
use super::materials::{self, Found, Transform};
use super::said::{MATERIAL, NODE, Said};
use super::{File, Refusal};
use crate::format::limits::{Flag, Limits};
use crate::radiance::Rgb;
use crate::scene::Material;
use crate::scene::flat::Face;
use crate::scene::image::{self, Image, Images, Unread};
use crate::scene::report::NoteKind;
use ::gltf::mesh::Mode;
use ::gltf::{Document, Node, Primitive, Semantic, texture};
use glam::{DMat4, DVec2, DVec3};
use std::collections::HashMap;

/// The largest coordinate, as in OBJ files.
const FARTHEST: f64 = 1e30;

/// Points of a primitive at which its lamp's image is looked up, about.
const LOOKS: usize = 1 << 16;

/// A node and where it stands.
pub(super) struct Placed<'a> {
    /// The node.
    pub node: Node<'a>,
    /// From its own space to the scene's.
    pub to_scene: DMat4,
    /// Its name, or its number where it has none.
    pub name: String,
}

/// All nodes of a scene, each with its place, parents before children.
pub(super) fn nodes<'a>(
    document: &'a Document,
    scene: &::gltf::Scene<'a>,
) -> Result<Vec<Placed<'a>>, String> {
    let mut seen = vec![false; document.nodes().count()];
    let mut left: Vec<(Node, DMat4)> = scene.nodes().map(|n| (n, DMat4::IDENTITY)).collect();
    left.reverse();
    let mut placed = Vec::new();
    while let Some((node, parent)) = left.pop() {
        if std::mem::replace(&mut seen[node.index()], true) {
            return Err(format!("node {} is in the scene twice", node.index()));
        }
        let own = node.transform().matrix().map(|column| column.map(f64::from));
        let to_scene = parent * DMat4::from_cols_array_2d(&own);
        let children = node.children().map(|child| (child, to_scene));
        let at = left.len();
        left.extend(children);
        left[at..].reverse();
        let name = node.name().map_or_else(|| format!("node {}", node.index()), str::to_owned);
        placed.push(Placed { node, to_scene, name });
    }
    Ok(placed)
}

/// A material of the file and, where its lamp has an image, the mesh and primitive that show it.
type Made = (Option<usize>, Option<(usize, usize)>);

/// What has been made of meshes.
pub(super) struct Meshes<'a> {
    buffers: &'a Buffers,
    limit: (u64, Flag),
    /// Corners in the scene's own metres.
    pub positions: Vec<DVec3>,
    /// The triangles.
    pub faces: Vec<Face>,
    /// What they are made of.
    pub materials: Vec<Material>,
    /// Images of these.
    pub images: Images<'a>,
    /// Numbers in `materials`.
    known: HashMap<Made, u32>,
}

/// A primitive as it is stored.
struct Stored {
    positions: Vec<[f32; 3]>,
    triangles: Vec<[u32; 3]>,
}

impl<'a> Meshes<'a> {
    /// None yet.
    pub fn new(buffers: &'a Buffers, images: Images<'a>, limits: &Limits) -> Meshes<'a> {
        Meshes {
            buffers,
            limit: limits.polygons(),
            positions: Vec::new(),
            faces: Vec::new(),
            materials: Vec::new(),
            images,
            known: HashMap::new(),
        }
    }

    /// Adds the mesh of a node, if it has one.
    pub fn add(&mut self, of: &Placed, file: &mut File, said: &mut Said) -> Result<(), Refusal> {
        let Some(mesh) = of.node.mesh() else { return Ok(()) };
        if of.node.skin().is_some() {
            said.add(NoteKind::Pose, NODE, &of.name, "skins are not supported, taken at rest");
        }
        for primitive in mesh.primitives() {
            if primitive.morph_targets().next().is_some() {
                let text = "morph targets are not supported, taken at rest";
                said.add(NoteKind::Pose, NODE, &of.name, text);
            }
            if primitive.get(&Semantic::Colors(0)).is_some() {
                let text = "colours of vertices are not supported, left out";
                said.add(NoteKind::VertexColours, NODE, &of.name, text);
            }
            let Some(stored) = self.stored(&primitive)? else {
                said.add(NoteKind::NoFaces, NODE, &of.name, "points and lines are left out");
                continue;
            };
            let number = mesh.index();
            let material = self.material(&primitive, number, &stored, file, said)?;
            self.add_primitive(&primitive, &stored, material, of.to_scene)?;
        }
        Ok(())
    }

    /// Corners and triangles of a primitive; none when it has none.
    fn stored(&self, primitive: &Primitive) -> Result<Option<Stored>, Refusal> {
        let mode = primitive.mode();
        if !matches!(mode, Mode::Triangles | Mode::TriangleStrip | Mode::TriangleFan) {
            return Ok(None);
        }
        let Some(accessor) = primitive.get(&Semantic::Positions) else { return Ok(None) };
        self.check(accessor.count() as u64 / 3)?;
        let positions = self.buffers.vectors::<3>(&accessor)?;
        let order = match primitive.indices() {
            Some(indices) => self.buffers.indices(&indices, positions.len())?,
            None => (0..positions.len() as u32).collect(),
        };
        let triangles: Vec<[u32; 3]> = match mode {
            Mode::TriangleStrip => {
                // Every other one runs the other way.
                let turned = |(k, t): (usize, &[u32])| match k % 2 {
                    0 => [t[0], t[1], t[2]],
                    _ => [t[1], t[0], t[2]],
                };
                order.windows(3).enumerate().map(turned).collect()
            }
            Mode::TriangleFan => order
                .get(1..)
                .unwrap_or_default()
                .windows(2)
                .map(|t| [order[0], t[0], t[1]])
                .collect(),
            _ => order.as_chunks::<3>().0.to_vec(),
        };
        self.check(triangles.len() as u64)?;
        Ok(Some(Stored { positions, triangles }))
    }

    /// Refuses more triangles than there may be, or as many corners as would take.
    fn check(&self, more: u64) -> Result<(), Refusal> {
        let (limit, flag) = self.limit;
        let found = more + (self.faces.len() as u64).max(self.positions.len() as u64 / 3);
        match found > limit {
            true => Err(Refusal::TooLarge("number of polygons", found, limit, flag)),
            false => Ok(()),
        }
    }

    fn add_primitive(
        &mut self,
        primitive: &Primitive,
        stored: &Stored,
        material: u32,
        to_scene: DMat4,
    ) -> Result<(), Refusal> {
        let textured = self.materials[material as usize].texture.is_some();
        let base = primitive.material().pbr_metallic_roughness().base_color_texture();
        let places = match base.filter(|_| textured) {
            Some(info) => Some(self.places(primitive, &Transform::of(&info), stored)?),
            None => None,
        };
        let first = self.positions.len() as u32;
        for position in &stored.positions {
            let own = DVec3::from(position.map(f64::from));
            let point = to_scene.transform_point3(own);
            if !point.is_finite() || point.abs().max_element() > FARTHEST {
                return Err(format!("a coordinate is beyond {FARTHEST:e}").into());
            }
            self.positions.push(point);
        }
        let mirrored = to_scene.determinant() < 0.0;
        // Both sides of a lamp shine when both sides of its material are meant.
        let emits = !self.materials[material as usize].emitted.is_black();
        let both = emits && primitive.material().double_sided();
        self.check(stored.triangles.len() as u64 * if both { 2 } else { 1 })?;
        for &[a, b, c] in &stored.triangles {
            let front = if mirrored { [a, c, b] } else { [a, b, c] };
            let [a, b, c] = front;
            let sides = [Some(front), both.then_some([a, c, b])];
            for side in sides.into_iter().flatten() {
                let own = |places: &Vec<DVec2>| {
                    side.iter().filter_map(|k| places.get(*k as usize).copied()).collect()
                };
                let corners = side.map(|k| first + k).to_vec();
                let places = places.as_ref().map(own);
                self.faces.push(Face { corners, places, material, line: 0 });
            }
        }
        Ok(())
    }

    /// The places of an image that a primitive's corners show; none where it has no such coordinates.
    fn places(
        &self,
        primitive: &Primitive,
        transform: &Transform,
        stored: &Stored,
    ) -> Result<Vec<DVec2>, String> {
        let Some(accessor) = primitive.get(&Semantic::TexCoords(transform.set)) else {
            return Ok(Vec::new());
        };
        if accessor.count() != stored.positions.len() {
            return Ok(Vec::new());
        }
        let places = self.buffers.vectors::<2>(&accessor)?;
        let places: Vec<DVec2> = places.into_iter().map(|p| transform.place(p)).collect();
        Ok(if places.iter().all(|p| p.is_finite()) { places } else { Vec::new() })
    }

    /// The number of a primitive's material.
    fn material(
        &mut self,
        primitive: &Primitive,
        mesh: usize,
        stored: &Stored,
        file: &mut File,
        said: &mut Said,
    ) -> Result<u32, Refusal> {
        let material = primitive.material();
        let shown = material
            .emissive_texture()
            .filter(|_| material.emissive_factor().iter().any(|c| *c > 0.0));
        let key = (material.index(), shown.as_ref().map(|_| (mesh, primitive.index())));
        if let Some(known) = self.known.get(&key) {
            return Ok(*known);
        }
        let mut found = Found::default();
        let name = materials::name(&material);
        if let Some(info) = material.pbr_metallic_roughness().base_color_texture() {
            found.base = self.image(&info.texture(), &name, file, said)?;
        }
        if let Some(info) = shown
            && let Some((number, mean)) = self.image(&info.texture(), &name, file, said)?
        {
            let places = self.places(primitive, &Transform::of(&info), stored)?;
            let image = &self.images.images[number as usize];
            found.emission = Some(mean_shown(image, stored, &places).unwrap_or(mean));
        }
        let number = self.materials.len() as u32;
        self.materials.push(materials::take(&material, &found, said));
        self.known.insert(key, number);
        Ok(number)
    }

    /// Number and mean of a texture's image; none, with a note, when it cannot be read.
    fn image(
        &mut self,
        texture: &texture::Texture,
        material: &str,
        file: &mut File,
        said: &mut Said,
    ) -> Result<Option<(u32, Rgb)>, Refusal> {
        let source = texture.source();
        let key = source.index().to_string();
        let buffers = self.buffers;
        match self.images.take(&key, || buffers.image(&source, file)) {
            Ok(found) => Ok(Some(found)),
            Err(Unread::Damaged(why)) => {
                let why = crate::format::text::inert(&why, 200);
                let text = format!("image {key} cannot be read: {why}; taken without");
                said.add(NoteKind::Image, MATERIAL, material, &text);
                Ok(None)
            }
            Err(too_large) => Err(too_large.into()),
        }
    }
}

/// The mean of an image over the triangles that show it, by points of each; `None` where they show none.
fn mean_shown(image: &Image, stored: &Stored, places: &[DVec2]) -> Option<Rgb> {
    let along = (LOOKS / stored.triangles.len().max(1)).isqrt().clamp(2, 64);
    let (mut sum, mut whole) = ([0.0; 3], 0.0);
    for corners in &stored.triangles {
        let [a, b, c] = corners.map(|k| DVec3::from(stored.positions[k as usize].map(f64::from)));
        let area = (b - a).cross(c - a).length();
        let [p, q, r] = corners.map(|k| places.get(k as usize).copied());
        let (p, q, r) = (p?, q?, r?);
        whole += area * (along * (along + 1) / 2) as f64;
        for (i, j) in (0..along).flat_map(|i| (0..along - i).map(move |j| (i, j))) {
            let at = |k: usize| (k as f64 + 1.0 / 3.0) / along as f64;
            let pixel = image.at(p + (q - p) * at(i) + (r - p) * at(j));
            (0..3).for_each(|c| sum[c] += area * f64::from(image::linear(pixel[c])));
        }
    }
    let mean = sum.map(|s| (s / (whole * f64::from(image::ONE))) as f32);
    Rgb(mean).is_physical().then_some(Rgb(mean))
}
