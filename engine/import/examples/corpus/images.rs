//! Images of the corpus: small files with mutated headers.

use super::Rng;

const JPEG: &[u8] = include_bytes!("../../tests/files/orange.jpg");
const PNG: &[u8] = include_bytes!("../../tests/files/linear.png");
const EXR: &[u8] = include_bytes!("../../tests/files/dotted.exr");

/// PNG chunks that affect the meaning of the pixels.
const CHUNKS: &[(&[u8; 4], &[u8])] = &[
    (b"cICP", &[9, 13, 0, 0]),
    (b"sRGB", &[0]),
    (b"gAMA", &[0, 1, 134, 160]),
    (b"cHRM", &[0; 32]),
    (b"iCCP", b"name\0\0\x78\x9c\x03\0\0\0\0\x01"),
    (b"acTL", &[0, 0, 0, 1, 0, 0, 0, 0]),
    (b"eXIf", b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0"),
    (b"tRNS", &[0, 7, 0, 7, 0, 7]),
];
/// JPEG segments that affect the meaning of the pixels.
const SEGMENTS: &[(u8, &[u8])] = &[
    (0xe1, b"Exif\0\0MM\0*\0\0\0\x08\0\x01\x01\x12\0\x03\0\0\0\x01\0\x06\0\0"),
    (0xe2, b"ICC_PROFILE\0\x01\x01profile"),
    (0xee, b"Adobe\0\x64\0\0\0\0\x01"),
    (0xe2, b"MPF\0MM\0*"),
];
/// Names of EXR attributes and channels.
const NAMES: &[&[u8]] =
    &[b".R", b"Y\0", b"RY", b"A\0", b"chromaticities\0chromaticities\0", b"whiteLuminance\0float\0"];

/// Returns an image in one of the formats, changed in a few places.
pub fn image(rng: &mut Rng) -> Vec<u8> {
    match rng.below(3) {
        0 => png(rng),
        1 => {
            let mut bytes = JPEG.to_vec();
            for _ in 0..rng.below(3) {
                let (marker, data) = rng.pick(SEGMENTS);
                let length = (data.len() as u16 + 2).to_be_bytes();
                bytes.splice(2..2, [&[0xff, *marker][..], &length, data].concat());
            }
            flip(rng, &mut bytes, 2);
            bytes
        }
        _ => {
            let mut bytes = EXR.to_vec();
            if rng.below(2) == 0 {
                let at = rng.below(300);
                let name = *rng.pick(NAMES);
                bytes.splice(at..(at + name.len()).min(bytes.len()), name.iter().copied());
            }
            flip(rng, &mut bytes, 4);
            bytes
        }
    }
}

/// Returns a PNG; most have correct checksums.
fn png(rng: &mut Rng) -> Vec<u8> {
    let mut bytes = PNG.to_vec();
    for _ in 0..rng.below(4) {
        let (kind, data) = *rng.pick(CHUNKS);
        let mut data = data.to_vec();
        flip(rng, &mut data, 0);
        let chunk = [&(data.len() as u32).to_be_bytes()[..], kind, &data, &[0; 4]].concat();
        bytes.splice(33..33, chunk);
    }
    if rng.below(3) == 0 {
        flip(rng, &mut bytes, 8);
    }
    let mut at = 8;
    while rng.below(50) > 0 {
        let Some(length) = bytes.get(at..at + 4) else { break };
        let length = u32::from_be_bytes([length[0], length[1], length[2], length[3]]) as usize;
        let Some(end) = at.checked_add(8 + length).filter(|end| end + 4 <= bytes.len()) else { break };
        let sum = crc32(&bytes[at + 4..end]).to_be_bytes();
        bytes[end..end + 4].copy_from_slice(&sum);
        at = end + 4;
    }
    bytes
}

/// Changes up to five bytes at or after `first`.
fn flip(rng: &mut Rng, bytes: &mut [u8], first: usize) {
    for _ in 0..rng.below(6) {
        if bytes.len() > first {
            let at = first + rng.below(bytes.len() - first);
            bytes[at] = if rng.below(2) == 0 { bytes[at] ^ 1 << rng.below(8) } else { rng.next() as u8 };
        }
    }
}

fn crc32(bytes: &[u8]) -> u32 {
    !bytes.iter().fold(!0u32, |crc, &byte| {
        (0..8).fold(crc ^ u32::from(byte), |c, _| if c & 1 == 1 { (c >> 1) ^ 0xedb8_8320 } else { c >> 1 })
    })
}
