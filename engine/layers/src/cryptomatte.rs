//! Ids of names by the Cryptomatte specification, version 1.1.0 (Psyop).
//!
//! An id is the MurmurHash3 of a name (x86, 32 bits, seed 0) as the bits of a float. Its exponent is kept away from 0 and 255, so
//! the float is never subnormal, infinite or NaN. Two names may share an id: expect about one pair among 65,000 names.

/// Name of everything unnamed: things outside of all objects, and the unnamed material.
pub const UNNAMED: &str = "default";

/// Computes the MurmurHash3 of bytes: the variant for x86 with 32 bits.
fn murmur3(bytes: &[u8], seed: u32) -> u32 {
    let scramble = |word: u32| word.wrapping_mul(0xcc9e_2d51).rotate_left(15).wrapping_mul(0x1b87_3593);
    let words = bytes.chunks_exact(4);
    let rest = words.remainder();
    let mut hash = seed;
    for word in words {
        let word = u32::from_le_bytes([word[0], word[1], word[2], word[3]]);
        hash = (hash ^ scramble(word)).rotate_left(13).wrapping_mul(5).wrapping_add(0xe654_6b64);
    }
    let word = rest.iter().rev().fold(0, |word, byte| word << 8 | u32::from(*byte));
    hash ^= scramble(word);
    hash ^= bytes.len() as u32;
    hash = (hash ^ hash >> 16).wrapping_mul(0x85eb_ca6b);
    hash = (hash ^ hash >> 13).wrapping_mul(0xc2b2_ae35);
    hash ^ hash >> 16
}

/// Returns the bits of the float that is the id of a name. They are never 0, which is the id of nothing.
pub fn id(name: &str) -> u32 {
    let hash = murmur3(name.as_bytes(), 0);
    let exponent = (hash >> 23 & 0xff).clamp(1, 254);
    hash & 0x807f_ffff | exponent << 23
}

/// Returns the metadata name of a layer: `cryptomatte/KEY/WHAT`, with the key from the layer's name.
/// - `field`: `name`, `hash`, `conversion` or `manifest`.
pub fn metadata_key(layer: &str, field: &str) -> String {
    let id = format!("{:08x}", id(layer));
    format!("cryptomatte/{}/{field}", &id[..7])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hash_is_murmur_hash_3_by_its_published_vectors() {
        for (text, seed, hash) in [
            ("", 0, 0),
            ("", 1, 0x514e_28b7),
            ("", 0xffff_ffff, 0x81f1_6f39),
            ("test", 0, 0xba6b_d213),
            ("test", 0x9747_b28c, 0x704b_81dc),
            ("Hello, world!", 0, 0xc036_3e43),
            ("Hello, world!", 0x9747_b28c, 0x2488_4cba),
            ("The quick brown fox jumps over the lazy dog", 0, 0x2e4f_f723),
            ("The quick brown fox jumps over the lazy dog", 0x9747_b28c, 0x2fa8_26cd),
        ] {
            assert_eq!(murmur3(text.as_bytes(), seed), hash, "{text:?} {seed:#x}");
        }
        for (bytes, seed, hash) in [
            (&[0xff; 4][..], 0, 0x7629_3b50),
            (&[0x21, 0x43, 0x65, 0x87][..], 0, 0xf55b_516b),
            (&[0x21, 0x43, 0x65, 0x87][..], 0x5082_edee, 0x2362_f9de),
            (&[0x21, 0x43, 0x65][..], 0, 0x7e4a_8634),
            (&[0x21, 0x43][..], 0, 0xa0f7_b07a),
            (&[0x21][..], 0, 0x7266_1cf4),
            (&[0; 4][..], 0, 0x2362_f9de),
            (&[0; 3][..], 0, 0x85f0_b427),
        ] {
            assert_eq!(murmur3(bytes, seed), hash, "{bytes:?}");
        }
    }

    #[test]
    fn ids_match_the_specification_and_its_authors_tests() {
        for (name, hex) in [("bunny", 0x1385_1a76), ("default", 0x42c9_679f), ("bunny_porcelain_mat", 0xb24b_26d4)] {
            assert_eq!(id(name), hex, "{name}");
        }
        for (name, value) in [
            ("hello", 6.070_562_5e-17f32),
            ("cube", -4.084_619_1e15),
            ("sphere", 2.790_186e15),
            ("plane", 3.665_576_2e-11),
            ("равнина", -1.319_263_1e-25),
            ("m\u{e4}dchen", 6.236_13e25),
        ] {
            let found = f32::from_bits(id(name));
            assert!((found - value).abs() <= 1e-6 * value.abs(), "{name}: {found}");
        }
        assert!((0..20_000).all(|number| f32::from_bits(id(&number.to_string())).is_normal()));
    }

    #[test]
    fn metadata_has_a_key_of_seven_digits_of_the_layers_name() {
        let hex = format!("{:08x}", id("crypto_object"));
        assert_eq!(metadata_key("crypto_object", "name"), format!("cryptomatte/{}/name", &hex[..7]));
        assert_ne!(metadata_key("crypto_object", "name"), metadata_key("crypto_material", "name"));
        // Names in the format have at most 31 characters.
        assert!(metadata_key("crypto_material", "conversion").len() <= 31);
    }
}
