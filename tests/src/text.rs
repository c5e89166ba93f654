//! Builds scene text from parts, for tests with many small scenes.

/// Returns a camera of 8 x 8 pixels.
pub fn camera(origin: &str, target: &str, fov: f64) -> String {
    format!("camera main =\n origin {origin}\n target {target}\n up .1 .2 .9\n fov {fov}\n film 8 8\n")
}

/// Returns a gray material of these lines.
pub fn material(name: &str, lines: &[&str]) -> String {
    format!("m {name} =\n c\n {}\n", lines.join("\n "))
}

/// Returns a quadrilateral of a material. Its front is the side where the corners run counterclockwise.
pub fn quad(material: &str, corners: [&str; 4]) -> String {
    let [a, b, c, d] = corners;
    format!("v qa =\n p {a}\nv qb =\n p {b}\nv qc =\n p {c}\nv qd =\n p {d}\nm {material}\nf qa qb qc qd\n")
}

/// Returns a closed box of a material with outward normals.
pub fn block(material: &str, [x0, y0, z0]: [f64; 3], [x1, y1, z1]: [f64; 3]) -> String {
    let corners = quad(
        material,
        [
            &format!("{x0} {y1} {z0}"),
            &format!("{x1} {y1} {z0}"),
            &format!("{x1} {y0} {z0}"),
            &format!("{x0} {y0} {z0}"),
        ],
    );
    corners.replace("\nf qa qb qc qd\n", &format!("\nprism qa qb qc qd {}\n", z1 - z0))
}

/// Returns a horizontal square around (`x`, `y`) at height `z`, which extends `half` to each side and faces up.
pub fn horizontal_square(material: &str, [x, y, z]: [f64; 3], half: f64) -> String {
    let corner = |dx: f64, dy: f64| format!("{} {} {z}", x + dx * half, y + dy * half);
    let corners = [corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0)];
    quad(material, corners.each_ref().map(String::as_str))
}
