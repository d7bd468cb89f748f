//! The paper's artificial scene (section 7.1): disjoint axis-aligned boxes in a cube with one emitter.

use std::fmt::Write;

/// Six walls and the two sides of the lamp.
const FIXED: u32 = 8;

/// Most boxes: the grid below holds no more.
const MOST_BOXES: u32 = 10_000;

/// Diffuse reflectances of the boxes.
const PALETTE: [[f64; 3]; 5] = [
    [0.75, 0.72, 0.65],
    [0.70, 0.35, 0.30],
    [0.35, 0.60, 0.35],
    [0.35, 0.45, 0.70],
    [0.72, 0.62, 0.30],
];

/// OBJ and MTL text (the OBJ names its library `boxes.mtl`) of about `polygons` polygons: 8 and 6 for
/// each box, at least one box and at most 10,000. The paper's scenes have 224 to 1,736 polygons. One
/// box of six is a mirror. The same arguments give the same scene.
pub fn box_field(polygons: u32, seed: u64) -> (String, String) {
    let boxes = ((polygons.saturating_sub(FIXED) + 3) / 6).clamp(1, MOST_BOXES) as usize;
    let [nx, ny, nz] = grid(boxes);
    let mut random = SplitMix(seed);
    let mut cells = choose(nx * ny * nz, boxes, &mut random);
    let mirrors = choose(boxes, ((boxes + 3) / 6).max(1), &mut random);
    cells.sort_unstable();

    let mut obj = Obj { text: "mtllib boxes.mtl\n".to_owned() };
    let room = BoxShape { low: [-1.0; 3], high: [1.0; 3] };
    for (face, material) in ["wall_l", "wall_r", "wall", "wall", "wall", "wall"].iter().enumerate()
    {
        let mut inward = room.face(face);
        inward.reverse();
        obj.polygon(material, inward);
    }
    // The lamp emits downwards; a diffuse panel lies on its back.
    let lamp = BoxShape { low: [-0.3, 0.96, -0.3], high: [0.3, 0.965, 0.3] };
    obj.polygon("light", lamp.face(2));
    obj.polygon("panel", lamp.face(3));

    // Boxes fill x in [-0.95, 0.95], y below the lamp, and z up to 0.55: cameras stand in front.
    let cell = [1.9 / nx as f64, 1.72 / ny as f64, 1.5 / nz as f64];
    for (number, place) in cells.into_iter().enumerate() {
        let at = [place % nx, place / (nx * nz), place / nx % nz];
        let (mut low, mut high) = ([0.0; 3], [0.0; 3]);
        for axis in 0..3 {
            let edge = random.between(0.34, 0.52);
            let start = at[axis] as f64 + random.between(0.08, 0.92 - edge);
            low[axis] = -0.95 + cell[axis] * start;
            high[axis] = low[axis] + cell[axis] * edge;
        }
        let colour = random.below(PALETTE.len());
        let material =
            if mirrors.contains(&number) { "mirror".to_owned() } else { format!("d{colour}") };
        let shape = BoxShape { low, high };
        (0..6).for_each(|face| obj.polygon(&material, shape.face(face)));
    }
    (obj.text, materials())
}

fn materials() -> String {
    let mut mtl = String::from(
        "newmtl wall\nKd 0.7 0.7 0.7\nillum 1\n\nnewmtl wall_l\nKd 0.65 0.25 0.2\nillum 1\n\n\
         newmtl wall_r\nKd 0.25 0.35 0.65\nillum 1\n\nnewmtl light\nKd 0 0 0\nKe 12 12 11\nillum 1\n\n\
         newmtl panel\nKd 0.5 0.5 0.5\nillum 1\n\n\
         newmtl mirror\nKd 0 0 0\nKs 0.85 0.85 0.85\nNs 100000\nillum 3\n",
    );
    for (i, [r, g, b]) in PALETTE.iter().enumerate() {
        // Writing to a string cannot fail.
        let _ = write!(mtl, "\nnewmtl d{i}\nKd {r} {g} {b}\nillum 1\n");
    }
    mtl
}

/// The grid nearest to a cube that holds so many cells with the fewest to spare.
fn grid(cells: usize) -> [usize; 3] {
    let mut best = (usize::MAX, [1, 1, cells]);
    for a in 1..=22 {
        for b in a..=22 {
            let c = cells.div_ceil(a * b);
            if c >= b && c <= 3 * a + 1 {
                let cost = (a * b * c - cells) * 10 + (c - a);
                if cost < best.0 {
                    best = (cost, [b, a, c]);
                }
            }
        }
    }
    best.1
}

/// `count` of the numbers below `n`, no two alike, in random order.
fn choose(n: usize, count: usize, random: &mut SplitMix) -> Vec<usize> {
    let mut all: Vec<usize> = (0..n).collect();
    for i in 0..count {
        let other = i + random.below(n - i);
        all.swap(i, other);
    }
    all.truncate(count);
    all
}

struct BoxShape {
    low: [f64; 3],
    high: [f64; 3],
}

impl BoxShape {
    /// Face 0 to 5 (-x, +x, -y, +y, -z, +z), counter-clockwise from outside.
    fn face(&self, face: usize) -> [[f64; 3]; 4] {
        let axis = face / 2;
        let (i, j) = ((axis + 1) % 3, (axis + 2) % 3);
        let mut corners = [[0.0; 3]; 4];
        for (corner, (a, b)) in corners.iter_mut().zip([(0, 0), (1, 0), (1, 1), (0, 1)]) {
            corner[axis] = [self.low, self.high][face % 2][axis];
            corner[i] = [self.low, self.high][a][i];
            corner[j] = [self.low, self.high][b][j];
        }
        if face.is_multiple_of(2) {
            corners.reverse();
        }
        corners
    }
}

struct Obj {
    text: String,
}

impl Obj {
    fn polygon(&mut self, material: &str, corners: [[f64; 3]; 4]) {
        for [x, y, z] in corners {
            // Writing to a string cannot fail.
            let _ = writeln!(self.text, "v {x:.6} {y:.6} {z:.6}");
        }
        let _ = writeln!(self.text, "usemtl {material}\nf -4 -3 -2 -1");
    }
}

/// Steele, Lea and Flood 2014, "Fast splittable pseudorandom number generators".
struct SplitMix(u64);

impl SplitMix {
    fn next(&mut self) -> u64 {
        self.0 = self.0.wrapping_add(0x9e37_79b9_7f4a_7c15);
        let z = (self.0 ^ (self.0 >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
        let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
        z ^ (z >> 31)
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.next() >> 11) as f64 / (1u64 << 53) as f64
    }

    /// A number below n; n is far below 2^64, so the remainder is even enough.
    fn below(&mut self, n: usize) -> usize {
        (self.next() % n as u64) as usize
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Scene;
    use std::path::Path;

    #[test]
    fn the_papers_sizes_come_out_five_to_one() {
        for polygons in [224, 488, 908, 1736] {
            let (obj, mtl) = box_field(polygons, 1);
            let open =
                Scene::from_text(Path::new("boxes.obj"), &obj, &mut |_| Ok(mtl.clone().into()));
            let (scene, report) = open.unwrap();
            assert_eq!(report.notes, []);
            assert_eq!(report.counts.polygons, polygons as usize);
            assert_eq!(report.counts.surfaces, polygons as usize, "boxes are disjoint");
            assert_eq!(report.counts.emitters, 1);
            assert_eq!(report.counts.mirrors, (polygons as usize - 8 + 18) / 36 * 6);
            let wall = scene.surfaces[0].normal;
            assert_eq!(wall.x, 1.0, "walls face the room");
        }
        assert_eq!(box_field(300, 7), box_field(300, 7));
        assert_ne!(box_field(300, 7), box_field(300, 8));
        assert!(box_field(0, 0).0.lines().filter(|l| l.starts_with('f')).count() == 14);
    }
}
