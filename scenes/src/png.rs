//! Tiny textures as PNG files, eight bits, uncompressed, because a deflate encoder would not pay off.

/// An 8 x 8 board of warm and cool fields, 2 x 2 pixels each, with one field of another color that shows the orientation.
pub fn checker() -> Vec<u8> {
    let pixel = |x: u32, y: u32| match (x / 2 + y / 2) % 2 {
        _ if x < 2 && y < 2 => [220, 40, 30],
        0 => [235, 225, 200],
        _ => [70, 100, 150],
    };
    encode(8, 8, pixel)
}

/// An 8 x 8 normal map: ripples along x, in tangent space, (128, 128, 255) is flat.
pub fn ripples() -> Vec<u8> {
    // A tilt of asin(0.3); z = 127.5 (1 + sqrt(1 - 0.09)).
    encode(8, 8, |x, _| match x % 4 {
        0 => [166, 128, 249],
        2 => [90, 128, 249],
        _ => [128, 128, 255],
    })
}

fn encode(width: u32, height: u32, pixel: impl Fn(u32, u32) -> [u8; 3]) -> Vec<u8> {
    let mut rows = Vec::new();
    for y in 0..height {
        rows.push(0); // no row filter
        rows.extend((0..width).flat_map(|x| pixel(x, y)));
    }
    debug_assert!(rows.len() < 65_536, "one stored block");
    let length = rows.len() as u16;
    let mut stream = vec![0x78, 0x01, 0x01];
    stream.extend(length.to_le_bytes());
    stream.extend((!length).to_le_bytes());
    stream.extend(&rows);
    stream.extend(adler32(&rows).to_be_bytes());

    let mut header = Vec::new();
    header.extend(width.to_be_bytes());
    header.extend(height.to_be_bytes());
    header.extend([8, 2, 0, 0, 0]); // bits, RGB, deflate, adaptive filters, no interlace
    let mut file = b"\x89PNG\r\n\x1a\n".to_vec();
    for (kind, data) in [(b"IHDR", &header), (b"IDAT", &stream), (b"IEND", &Vec::new())] {
        file.extend((data.len() as u32).to_be_bytes());
        let start = file.len();
        file.extend(kind);
        file.extend(data);
        file.extend(crc32(&file[start..]).to_be_bytes());
    }
    file
}

fn adler32(bytes: &[u8]) -> u32 {
    let (a, b) = bytes.iter().fold((1_u32, 0_u32), |(a, b), &x| {
        let a = (a + u32::from(x)) % 65_521;
        (a, (b + a) % 65_521)
    });
    b << 16 | a
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0_u32, |crc, &x| {
        (0..8).fold(crc ^ u32::from(x), |c, _| if c & 1 == 1 { c >> 1 ^ 0xedb8_8320 } else { c >> 1 })
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn checksums_match_their_published_check_values() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
        assert_eq!(adler32(b"Wikipedia"), 0x11e6_0398);
    }

    #[test]
    fn textures_are_a_few_hundred_bytes() {
        for texture in [checker(), ripples()] {
            assert!(texture.len() < 400, "{} bytes", texture.len());
        }
    }
}
