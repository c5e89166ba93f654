//! Generates furnished rooms. Equal seeds give equal rooms.
//!
//! Each feature of a room is drawn from random numbers of its own. A room without one of its features is otherwise the same room.

use crate::rng::Rng;
use std::f64::consts::PI;
use std::fmt::Write as _;

/// Names of the features, and the probability of each.
pub const FEATURES: [(&str, f64); 26] = [
    ("corridor", 0.2),
    ("l-shape", 0.25),
    ("sloped", 0.25),
    ("open", 0.25),
    ("second-room", 0.25),
    ("white", 0.2),
    ("one-sided-walls", 0.4),
    ("one-sided-objects", 0.3),
    ("glossy", 0.3),
    ("touching", 0.5),
    ("boxes", 0.6),
    ("overlap", 0.35),
    ("tables", 0.4),
    ("shelves", 0.35),
    ("curved", 0.35),
    ("warped", 0.3),
    ("slivers", 0.3),
    ("rug", 0.35),
    ("coplanar", 0.25),
    ("mirror", 0.25),
    ("glass", 0.2),
    ("housing", 0.35),
    ("close-lamp", 0.3),
    ("sphere-lamp", 0.35),
    ("small-lamp", 0.25),
    ("two-sided-lamp", 0.35),
];

/// Name of the feature of [`RoomOptions::fog`].
const FOG: &str = "fog";

/// Settings of the generator.
#[derive(Clone, Debug, Default)]
pub struct RoomOptions {
    /// Names of features that are left out.
    pub without: Vec<String>,
    /// Whether a part of the room has fog.
    pub fog: bool,
}

/// A generated room.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RandomRoom {
    /// Text of the scene.
    pub text: String,
    /// Names of its features.
    pub features: Vec<&'static str>,
    /// Number of faces, each side of a box counted separately, and of curved surfaces.
    pub faces: usize,
}

/// Random numbers of a feature.
struct Draw(Rng);

impl Draw {
    fn new(seed: u64, what: &str) -> Self {
        // FNV-1a.
        let mix = |sum: u64, byte: u8| (sum ^ u64::from(byte)).wrapping_mul(0x0100_0000_01b3);
        Self(Rng::new(what.bytes().fold(seed ^ 0xcbf2_9ce4_8422_2325, mix)))
    }

    fn between(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * (self.0.bits() >> 11) as f64 / (1u64 << 53) as f64
    }

    fn has(&mut self, probability: f64) -> bool {
        self.between(0.0, 1.0) < probability
    }

    fn count(&mut self, low: usize, high: usize) -> usize {
        low + self.0.below(high - low + 1)
    }
}

/// Luminous flux of each lamp, lm.
const FLUX: f64 = 2000.0;
/// Corner of the room that is free for the camera, m.
const CAMERA_CORNER: f64 = 1.3;

/// Builder of a room. Its interior is `x < size[0] && y < size[1]`, and in an L also `x < inner[0] || y < inner[1]`.
struct Builder {
    seed: u64,
    text: String,
    names: usize,
    faces: usize,
    features: Vec<&'static str>,
    size: [f64; 3],
    inner: [f64; 2],
    /// Height of the ceiling at the greatest x over that at x = 0.
    slope: f64,
    /// Occupied rectangles of the floor: x0, y0, x1, y1.
    occupied: Vec<[f64; 4]>,
}

/// Generates the room of a seed.
pub fn random_room(seed: u64, options: &RoomOptions) -> RandomRoom {
    let mut draw = Draw::new(seed, "features");
    let drawn: Vec<&str> = FEATURES.iter().filter(|(_, chance)| draw.has(*chance)).map(|(name, _)| *name).collect();
    let features = drawn.into_iter().filter(|name| !options.without.iter().any(|other| other == name)).collect();
    let mut room = Builder::new(seed, features);
    room.materials();
    room.shell();
    room.furnish();
    room.decorate();
    room.lamps();
    if options.fog {
        room.fog();
    }
    RandomRoom { text: room.text, features: room.features, faces: room.faces }
}

impl Builder {
    fn new(seed: u64, features: Vec<&'static str>) -> Self {
        let has = |name: &str| features.contains(&name);
        let mut draw = Draw::new(seed, "size");
        let mut size = [draw.between(3.2, 6.5), draw.between(3.2, 5.5), draw.between(2.4, 3.3)];
        let share = [draw.between(0.5, 0.7), draw.between(0.5, 0.7)];
        let corridor = [draw.between(7.0, 12.0), draw.between(1.8, 2.6)];
        let slope = draw.between(0.65, 0.85);
        if has("corridor") {
            [size[0], size[1]] = corridor;
        }
        let inner = if has("l-shape") { [share[0] * size[0], share[1] * size[1]] } else { [size[0], size[1]] };
        let slope = if has("sloped") { slope } else { 1.0 };
        let (text, occupied) = (String::new(), Vec::new());
        let mut room = Self { seed, text, names: 0, faces: 0, features, size, inner, slope, occupied };
        let eye = [0.3, 0.3, draw.between(1.2, 1.7)];
        let target = [0.55 * room.inner[0], 0.6 * room.inner[1], 0.4 * size[2]];
        let _ = writeln!(
            room.text,
            "camera main =\n  origin {} {} {:.4}\n  target {:.4} {:.4} {:.4}\n  fov 65\n  film 96 72",
            eye[0], eye[1], eye[2], target[0], target[1], target[2]
        );
        room
    }

    fn has(&self, name: &str) -> bool {
        self.features.contains(&name)
    }

    fn draw(&self, what: &str) -> Draw {
        Draw::new(self.seed, what)
    }

    /// Returns the least height of the ceiling over x up to this one, m.
    fn ceiling(&self, x: f64) -> f64 {
        self.size[2] * (1.0 + (self.slope - 1.0) * x / self.size[0])
    }

    fn materials(&mut self) {
        let mut draw = self.draw("materials");
        for name in ["floor", "wall", "ceiling", "wood", "paint", "cloth", "metal", "housing"] {
            let is_shell = matches!(name, "floor" | "wall" | "ceiling");
            let [low, high] = match (self.has("white"), is_shell) {
                (true, true) => [0.9, 0.99],
                (true, false) => [0.7, 0.98],
                (false, true) => [0.3, 0.8],
                (false, false) => [0.1, 0.8],
            };
            let reflectance = draw.between(low, high);
            let color = [draw.between(0.28, 0.42), draw.between(0.3, 0.38)];
            let (is_colored, gloss, roughness) = (draw.has(0.3), draw.between(0.05, 0.3), draw.between(0.05, 0.4));
            let is_glossy = self.has("glossy") && matches!(name, "floor" | "wood" | "metal");
            let is_one_sided =
                if is_shell { self.has("one-sided-walls") } else { self.has("one-sided-objects") && name != "housing" };
            let sides = if is_one_sided { "  sides 1\n" } else { "" };
            let _ = writeln!(self.text, "m {name} =\n{sides}  c");
            if is_colored && !self.has("white") {
                let _ = writeln!(self.text, "  c {name}_color =\n  cxy {:.4} {:.4}", color[0], color[1]);
            }
            let diffuse = if is_glossy { reflectance.min(0.99 - gloss) } else { reflectance };
            let _ = writeln!(self.text, "  rd {diffuse:.4}\n  c");
            if is_glossy {
                let _ = writeln!(self.text, "  rs {gloss:.4} {roughness:.4}");
            }
        }
        self.text.push_str("m mirror =\n  c\n  rs .9 0\nm glass =\n  sides 1\n  c\n  ir 1.5 0\n  ts 1 0\n");
    }

    fn material(&mut self, name: &str) {
        let _ = writeln!(self.text, "m {name}");
    }

    fn vertex(&mut self, [x, y, z]: [f64; 3]) -> String {
        let name = format!("v{}", self.names);
        self.names += 1;
        let _ = writeln!(self.text, "v {name} =\n  p {x:.6} {y:.6} {z:.6}");
        name
    }

    /// Appends a polygon. Its front is the side where the corners run counterclockwise.
    fn polygon(&mut self, corners: &[[f64; 3]]) {
        let names: Vec<String> = corners.iter().map(|corner| self.vertex(*corner)).collect();
        let _ = writeln!(self.text, "f {}", names.join(" "));
        self.faces += 1;
    }

    /// Appends a box whose sides look outward.
    fn block(&mut self, material: &str, low: [f64; 3], high: [f64; 3]) {
        self.material(material);
        for face in [[0, 2, 3, 1], [4, 5, 7, 6], [0, 1, 5, 4], [2, 6, 7, 3], [0, 4, 6, 2], [1, 3, 7, 5]] {
            let at = |corner: usize| [0, 1, 2].map(|axis| if corner >> axis & 1 == 0 { low[axis] } else { high[axis] });
            self.polygon(&face.map(at));
        }
    }

    /// Appends a horizontal rectangle.
    fn level(&mut self, [x0, y0]: [f64; 2], [x1, y1]: [f64; 2], z: f64, is_up: bool) {
        let mut corners = [[x0, y0, z], [x1, y0, z], [x1, y1, z], [x0, y1, z]];
        if !is_up {
            corners.reverse();
        }
        self.polygon(&corners);
    }

    fn sphere(&mut self, material: &str, center: [f64; 3], radius: f64) {
        self.material(material);
        let name = self.vertex(center);
        let _ = writeln!(self.text, "sph {name} {radius:.5}");
        self.faces += 1;
    }

    /// Appends floor, ceiling and walls, and the second room behind the wall at the greatest x.
    fn shell(&mut self) {
        let ([x, y, _], [a, b]) = (self.size, self.inner);
        let outline = if self.has("l-shape") {
            vec![[0.0, 0.0], [x, 0.0], [x, b], [a, b], [a, y], [0.0, y]]
        } else {
            vec![[0.0, 0.0], [x, 0.0], [x, y], [0.0, y]]
        };
        let mut draw = self.draw("open");
        let openings = if draw.has(0.4) { None } else { Some(draw.count(2, outline.len() - 2)) };
        let is_open = self.has("open");
        self.material("floor");
        self.polygon(&outline.iter().map(|[x, y]| [*x, *y, 0.0]).collect::<Vec<_>>());
        if !is_open || openings.is_some() {
            self.material("ceiling");
            let ceiling: Vec<_> = outline.iter().rev().map(|[x, y]| [*x, *y, self.ceiling(*x)]).collect();
            self.polygon(&ceiling);
        }
        for (k, [x0, y0]) in outline.iter().copied().enumerate() {
            if is_open && openings == Some(k) {
                continue;
            }
            let [x1, y1] = outline[(k + 1) % outline.len()];
            if k == 1 && self.has("second-room") {
                self.second_room([x, y1]);
                continue;
            }
            self.material("wall");
            // The interior is to the left of the way around.
            self.polygon(&[[x0, y0, 0.0], [x0, y0, self.ceiling(x0)], [x1, y1, self.ceiling(x1)], [x1, y1, 0.0]]);
        }
    }

    /// Appends a wall at `x`, with a gap of a door, and a room behind it.
    fn second_room(&mut self, [x, width]: [f64; 2]) {
        let mut draw = self.draw("second-room");
        let gap = draw.between(0.1, 0.9).min(0.5 * width);
        let left = draw.between(0.1, width - gap - 0.1);
        let [top, height] = [1.0f64.min(self.ceiling(x) / 2.4) * 2.0, self.ceiling(x)];
        let depth = draw.between(2.0, 3.5);
        let (near, far) = (x + 0.1, x + 0.1 + depth);
        self.material("wall");
        for (x, faces_back) in [(x, true), (near, false)] {
            for [y0, y1, z0, z1] in
                [[0.0, left, 0.0, height], [left + gap, width, 0.0, height], [left, left + gap, top, height]]
            {
                let mut corners = [[x, y0, z0], [x, y1, z0], [x, y1, z1], [x, y0, z1]];
                if faces_back {
                    corners.reverse();
                }
                self.polygon(&corners);
            }
        }
        // The gap's sides, floor and top.
        let [y0, y1] = [left, left + gap];
        self.polygon(&[[x, y0, 0.0], [x, y0, top], [near, y0, top], [near, y0, 0.0]]);
        self.polygon(&[[x, y1, 0.0], [near, y1, 0.0], [near, y1, top], [x, y1, top]]);
        self.level([x, y0], [near, y1], 0.0, true);
        self.level([x, y0], [near, y1], top, false);
        self.material("floor");
        self.level([near, 0.0], [far, width], 0.0, true);
        self.material("ceiling");
        self.level([near, 0.0], [far, width], height, false);
        self.material("wall");
        self.polygon(&[[near, 0.0, 0.0], [near, 0.0, height], [far, 0.0, height], [far, 0.0, 0.0]]);
        self.polygon(&[[near, width, 0.0], [far, width, 0.0], [far, width, height], [near, width, height]]);
        self.polygon(&[[far, 0.0, 0.0], [far, 0.0, height], [far, width, height], [far, width, 0.0]]);
    }

    /// Finds free floor for an object of this size, m.
    fn place(&mut self, draw: &mut Draw, [wide, deep]: [f64; 2]) -> Option<[f64; 2]> {
        // The number of random numbers does not depend on what is occupied.
        let tries: Vec<[f64; 2]> = (0..24)
            .map(|_| [draw.between(0.05, self.size[0] - wide - 0.05), draw.between(0.05, self.size[1] - deep - 0.05)])
            .collect();
        let is_free = |[x, y]: &[f64; 2]| {
            let inside = x + wide < self.inner[0] - 0.02 || y + deep < self.inner[1] - 0.02;
            let apart = |[x0, y0, x1, y1]: &[f64; 4]| x + wide < *x0 || *x1 < *x || y + deep < *y0 || *y1 < *y;
            *x >= 0.0
                && *y >= 0.0
                && inside
                && (*x > CAMERA_CORNER || *y > CAMERA_CORNER)
                && self.occupied.iter().all(apart)
        };
        let found = tries.iter().copied().find(is_free)?;
        self.occupied.push([found[0], found[1], found[0] + wide, found[1] + deep]);
        Some(found)
    }

    fn furnish(&mut self) {
        let mut draw = self.draw("feet");
        let feet = draw.between(0.01, 0.05);
        let bottom = if self.has("touching") { 0.0 } else { feet };
        if self.has("shelves") {
            self.shelf(bottom);
        }
        if self.has("tables") {
            let mut draw = self.draw("tables");
            for _ in 0..draw.count(1, 2) {
                self.table(&mut draw, bottom);
            }
        }
        if self.has("boxes") {
            let mut draw = self.draw("boxes");
            for _ in 0..draw.count(2, 6) {
                let size = [draw.between(0.2, 0.9), draw.between(0.2, 0.9), draw.between(0.2, 1.6)];
                let material = ["wood", "paint", "cloth", "metal"][draw.count(0, 3)];
                if let Some([x, y]) = self.place(&mut draw, [size[0], size[1]]) {
                    self.block(material, [x, y, bottom], [x + size[0], y + size[1], bottom + size[2]]);
                }
            }
        }
        if self.has("overlap") {
            let mut draw = self.draw("overlap");
            if let Some([x, y]) = self.place(&mut draw, [1.0, 1.0]) {
                for _ in 0..draw.count(2, 4) {
                    let at = [x + draw.between(0.0, 0.5), y + draw.between(0.0, 0.5)];
                    let size = [draw.between(0.25, 0.5), draw.between(0.25, 0.5), draw.between(0.2, 1.0)];
                    let material = ["wood", "paint", "cloth"][draw.count(0, 2)];
                    self.block(material, [at[0], at[1], bottom], [at[0] + size[0], at[1] + size[1], bottom + size[2]]);
                }
            }
        }
        if self.has("curved") {
            let mut draw = self.draw("curved");
            for k in 0..draw.count(1, 3) {
                let (radius, height) = (draw.between(0.1, 0.35), draw.between(0.3, 1.2));
                let Some([x, y]) = self.place(&mut draw, [2.0 * radius; 2]) else { continue };
                let [x, y] = [x + radius, y + radius];
                if k % 2 == 0 {
                    self.sphere("paint", [x, y, bottom + radius], radius);
                } else {
                    self.material("metal");
                    let [low, high] = [bottom, bottom + height].map(|z| self.vertex([x, y, z]));
                    let _ = writeln!(self.text, "v {high}\n  n 0 0 1");
                    let _ = writeln!(self.text, "cyl {low} {radius:.5} {high}\nring {high} 0 {radius:.5}");
                    self.faces += 2;
                }
            }
        }
    }

    /// Appends two upright sides and thin boards between them.
    fn shelf(&mut self, bottom: f64) {
        let mut draw = self.draw("shelves");
        let [wide, deep, high] = [draw.between(0.6, 1.2), draw.between(0.2, 0.4), draw.between(0.8, 1.8)];
        let (boards, thickness) = (draw.count(2, 5), draw.between(0.01, 0.025));
        let Some([x, y]) = self.place(&mut draw, [wide, deep]) else { return };
        for side in [x, x + wide - thickness] {
            self.block("wood", [side, y, bottom], [side + thickness, y + deep, bottom + high]);
        }
        for k in 0..boards {
            let z = bottom + 0.05 + (high - 0.1) * k as f64 / (boards - 1) as f64;
            // Boards touch the sides.
            self.block("wood", [x + thickness, y, z], [x + wide - thickness, y + deep, z + thickness]);
        }
    }

    fn table(&mut self, draw: &mut Draw, bottom: f64) {
        let [wide, deep, high] = [draw.between(0.7, 1.3), draw.between(0.5, 0.8), draw.between(0.6, 0.8)];
        let (plate, leg) = (draw.between(0.01, 0.04), draw.between(0.02, 0.06));
        let Some([x, y]) = self.place(draw, [wide, deep]) else { return };
        self.block("wood", [x, y, bottom + high - plate], [x + wide, y + deep, bottom + high]);
        for k in 0..4 {
            let [x, y] = [x + [0.03, wide - leg - 0.03][k % 2], y + [0.03, deep - leg - 0.03][k / 2]];
            self.block("metal", [x, y, bottom], [x + leg, y + leg, bottom + high - plate]);
        }
    }

    /// Appends thin and unusual faces, mirrors and glass.
    fn decorate(&mut self) {
        let ([_, y, z], [a, b]) = (self.size, self.inner);
        if self.has("rug") {
            let mut draw = self.draw("rug");
            let height = draw.between(0.0, 1e-3);
            self.material("cloth");
            self.level([0.35 * a, 0.3 * b], [0.75 * a, 0.8 * b], height, true);
        }
        if self.has("coplanar") {
            self.material("paint");
            self.level([0.2 * a, 0.1 * b], [0.4 * a, 0.5 * b], 0.0, true);
            // On the wall at x = 0.
            self.polygon(&[[0.0, 0.5 * y, 1.0], [0.0, 0.8 * y, 1.0], [0.0, 0.8 * y, 1.6], [0.0, 0.5 * y, 1.6]]);
        }
        if self.has("warped") {
            let mut draw = self.draw("warped");
            self.material("cloth");
            for _ in 0..draw.count(1, 3) {
                let at = [draw.between(0.3 * a, 0.6 * a), draw.between(0.4 * b, 0.7 * b), draw.between(0.4, 1.2)];
                let wide = draw.between(0.4, 0.8);
                let corner =
                    |k: usize, off: f64| [at[0] + wide * (k % 2) as f64, at[1] + off, at[2] + wide * (k / 2) as f64];
                let corners = [0, 1, 3, 2].map(|k| corner(k, draw.between(-0.15, 0.15) * wide));
                self.polygon(&corners);
            }
        }
        if self.has("slivers") {
            let mut draw = self.draw("slivers");
            self.material("metal");
            for _ in 0..draw.count(4, 12) {
                let at = [draw.between(0.3 * a, 0.8 * a), draw.between(0.5 * b, 0.9 * b), draw.between(0.2, 1.2)];
                let (length, width) = (draw.between(0.5, 2.0), draw.between(1e-4, 5e-3));
                let rise = draw.between(-0.1, 0.5);
                let length = length.min(a - at[0] - 0.01);
                let tip = [at[0] + length, at[1], at[2] + rise];
                self.polygon(&[at, tip, [at[0], at[1] + width, at[2]]]);
            }
        }
        if self.has("mirror") {
            let mut draw = self.draw("mirror");
            if draw.has(0.6) {
                self.material("mirror");
                self.polygon(&[
                    [0.01, 0.5 * y, 0.5],
                    [0.01, 0.85 * y, 0.5],
                    [0.01, 0.85 * y, 1.8],
                    [0.01, 0.5 * y, 1.8],
                ]);
            } else {
                self.sphere("mirror", [0.6 * a, 0.75 * b, 0.35 * z], draw.between(0.15, 0.3));
            }
        }
        if self.has("glass") {
            let mut draw = self.draw("glass");
            let at = [0.4 * a, 0.55 * b, draw.between(0.8, 1.2)];
            let size = draw.between(0.1, 0.25);
            if draw.has(0.6) {
                self.sphere("glass", at, size);
            } else {
                self.block("glass", at, [at[0] + size, at[1] + size, at[2] + 0.5 * size]);
            }
        }
    }

    /// Appends lamps of the kinds among the features, or a hanging panel if there is none.
    fn lamps(&mut self) {
        let mut draw = self.draw("lamps");
        let small = if self.has("small-lamp") { 0.08 } else { 1.0 };
        let [a, b] = self.inner;
        if self.has("close-lamp") {
            let half = small * draw.between(0.1, 0.4);
            let at = [0.35 * a, 0.5 * b];
            let gap = self.draw("close-lamp").between(0.002, 0.02);
            self.panel(at, half, self.ceiling(at[0] + half) - gap);
        }
        if self.has("sphere-lamp") {
            let mut draw = self.draw("sphere-lamp");
            let (radius, height) = (small * draw.between(0.05, 0.2), draw.between(0.4, 0.7));
            let at = [0.6 * a, 0.35 * b, height * self.ceiling(0.6 * a)];
            self.lamp_material("sphere_lamp", 4.0 * PI * radius * radius, "  sides 1\n");
            self.sphere("sphere_lamp", at, radius);
        }
        if self.has("housing") {
            self.housing(small);
        }
        if !["close-lamp", "sphere-lamp", "housing"].iter().any(|kind| self.has(kind)) {
            let half = small * draw.between(0.1, 0.35);
            let at = [0.45 * a, 0.45 * b];
            self.panel(at, half, self.ceiling(at[0] + half) - draw.between(0.2, 0.8));
        }
    }

    fn lamp_material(&mut self, name: &str, area: f64, sides: &str) {
        let _ = writeln!(self.text, "m {name} =\n{sides}  c\n  ed {:.4}", FLUX / area);
    }

    /// Appends a square lamp.
    fn panel(&mut self, [x, y]: [f64; 2], half: f64, z: f64) {
        let (area, sides) = if self.has("two-sided-lamp") { (8.0, "  sides 2\n") } else { (4.0, "  sides 1\n") };
        self.lamp_material("panel", area * half * half, sides);
        self.level([x - half, y - half], [x + half, y + half], z, false);
    }

    /// Appends a lamp in a box that is open below.
    fn housing(&mut self, small: f64) {
        let mut draw = self.draw("housing");
        let half = small.max(0.3) * draw.between(0.1, 0.3);
        let (deep, drop) = (draw.between(0.05, 0.25), draw.between(0.002, 0.5));
        let [x, y] = [0.7 * self.inner[0], 0.6 * self.inner[1]];
        let top = self.ceiling(x + half) - drop;
        self.material("housing");
        self.level([x - half, y - half], [x + half, y + half], top, true);
        for [x0, y0, x1, y1] in
            [[-1.0, -1.0, 1.0, -1.0], [1.0, -1.0, 1.0, 1.0], [1.0, 1.0, -1.0, 1.0], [-1.0, 1.0, -1.0, -1.0]]
        {
            let [p, q] = [[x + half * x0, y + half * y0], [x + half * x1, y + half * y1]];
            self.polygon(&[[p[0], p[1], top - deep], [q[0], q[1], top - deep], [q[0], q[1], top], [p[0], p[1], top]]);
        }
        if draw.has(0.4) {
            let radius = 0.35 * half.min(deep);
            self.lamp_material("housed_lamp", 4.0 * PI * radius * radius, "  sides 1\n");
            self.sphere("housed_lamp", [x, y, top - 0.5 * deep], radius);
        } else {
            let (inner, gap) = (half * draw.between(0.5, 0.95), deep * draw.between(0.1, 0.5));
            self.panel([x, y], inner, top - gap);
        }
    }

    fn fog(&mut self) {
        let mut draw = self.draw(FOG);
        let (scattering, absorption) = (draw.between(0.1, 0.8), draw.between(0.0, 0.1));
        let [x, y, z] = self.size;
        let (low, high) = (draw.between(0.0, 0.4), draw.between(0.5, 1.0));
        let _ = writeln!(
            self.text,
            "medium air =\n  sigma_s {scattering:.4}\n  sigma_a {absorption:.4}\nmbox air {:.4} 0 0 {:.4} {y:.4} {:.4}",
            low * x,
            high * x,
            self.slope * z
        );
        self.features.push(FOG);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use femc_import::{Bundle, load_scene};
    use std::collections::BTreeMap;

    #[test]
    fn rooms_depend_on_their_seed_alone() {
        let options = RoomOptions::default();
        for seed in 0..20 {
            assert_eq!(random_room(seed, &options), random_room(seed, &options));
            assert_ne!(random_room(seed, &options).text, random_room(seed + 1, &options).text);
        }
    }

    #[test]
    fn rooms_are_scenes_with_lamps() {
        for seed in 0..50 {
            let options = RoomOptions { fog: seed % 5 == 0, ..RoomOptions::default() };
            let room = random_room(seed, &options);
            let bundle = Bundle(BTreeMap::from([("room.mgf".to_owned(), room.text.clone().into_bytes())]));
            let loaded = load_scene(&bundle, "room.mgf").unwrap_or_else(|error| panic!("{seed}: {error}"));
            let source = femc_pipeline::SceneSource::new(loaded.scene.into());
            let prepared = femc_pipeline::prepare_world(&source, &femc_pipeline::Settings::default(), 1, None)
                .unwrap_or_else(|error| panic!("{seed}: {error}"));
            assert!(!prepared.lights.is_empty() && room.faces >= 6, "{seed}: {:?}", room.features);
            assert_eq!(prepared.media.is_empty(), !options.fog);
        }
    }

    #[test]
    fn every_feature_is_in_some_rooms_and_not_in_others() {
        let rooms: Vec<RandomRoom> = (0..50).map(|seed| random_room(seed, &RoomOptions::default())).collect();
        for (name, _) in FEATURES {
            let with = rooms.iter().filter(|room| room.features.contains(&name)).count();
            assert!(with > 0 && with < rooms.len(), "{name}: {with}");
        }
    }

    /// The lines of a room without a feature are lines of the room, for features that only add objects.
    #[test]
    fn other_objects_stay_if_a_feature_is_left_out() {
        for feature in ["slivers", "mirror", "glass", "warped", "rug", "coplanar"] {
            let seed = (0..50)
                .find(|&seed| random_room(seed, &RoomOptions::default()).features.contains(&feature))
                .unwrap_or_else(|| panic!("{feature}"));
            let room = random_room(seed, &RoomOptions::default());
            let without =
                random_room(seed, &RoomOptions { without: vec![feature.to_owned()], ..RoomOptions::default() });
            assert!(without.faces < room.faces && !without.features.contains(&feature));
            let positions = |text: &str| -> Vec<String> {
                text.lines().filter(|line| line.starts_with("  p ")).map(str::to_owned).collect()
            };
            let all = positions(&room.text);
            assert!(positions(&without.text).iter().all(|line| all.contains(line)), "{feature}");
        }
    }
}
