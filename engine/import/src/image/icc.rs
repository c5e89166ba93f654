//! Names of color profiles.

use super::printable;

/// Returns the description of an ICC profile; `None` if it has no readable one.
pub(super) fn description(profile: &[u8]) -> Option<String> {
    let number = |at: usize| {
        let four = profile.get(at..at.checked_add(4)?)?;
        usize::try_from(u32::from_be_bytes(four.try_into().ok()?)).ok()
    };
    let tags = number(128)?.min(100);
    let entry = (0..tags).map(|i| 132 + 12 * i).find(|&at| profile.get(at..at + 4) == Some(b"desc"))?;
    let start = number(entry + 4)?;
    let text = match profile.get(start..start.checked_add(4)?)? {
        b"desc" => {
            let text = profile.get(start + 12..(start + 12).checked_add(number(start + 8)?)?)?;
            String::from_utf8_lossy(text).into_owned()
        }
        // The first translation, in UTF-16.
        b"mluc" => {
            let from = start.checked_add(number(start + 24)?)?;
            let text = profile.get(from..from.checked_add(number(start + 20)?)?)?;
            let units: Vec<u16> = text.chunks_exact(2).map(|pair| u16::from_be_bytes([pair[0], pair[1]])).collect();
            String::from_utf16_lossy(&units)
        }
        _ => return None,
    };
    Some(printable(&text)).filter(|text| !text.is_empty())
}

/// Returns whether a profile is sRGB, by its name.
pub(super) fn is_srgb(name: &str) -> bool {
    name.to_ascii_lowercase().contains("srgb")
}

/// Returns a remark that the profile is not applied, unless it is sRGB.
pub(super) fn remark(name: &str, instead: &str) -> Option<String> {
    (!is_srgb(name)).then(|| format!("color profile `{name}` is not applied: values are read as {instead}"))
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// Returns a profile that contains only a description, of either kind.
    pub fn profile(name: &str, is_unicode: bool) -> Vec<u8> {
        let mut bytes = vec![0; 128];
        bytes.extend([0, 0, 0, 1]);
        bytes.extend(b"desc");
        let text: Vec<u8> = if is_unicode {
            let units: Vec<u8> = name.encode_utf16().flat_map(u16::to_be_bytes).collect();
            let head = [
                &b"mluc\0\0\0\0\0\0\0\x01\0\0\0\x0cenUS"[..],
                &(units.len() as u32).to_be_bytes(),
                &28u32.to_be_bytes(),
            ];
            [&head.concat()[..], &units].concat()
        } else {
            [&b"desc\0\0\0\0"[..], &(name.len() as u32 + 1).to_be_bytes(), name.as_bytes(), b"\0"].concat()
        };
        bytes.extend(144u32.to_be_bytes());
        bytes.extend((text.len() as u32).to_be_bytes());
        bytes.extend(text);
        bytes
    }

    #[test]
    fn both_name_kinds_are_read_and_truncated_profiles_have_none() {
        for is_unicode in [true, false] {
            let whole = profile("Adobe RGB (1998)", is_unicode);
            assert_eq!(description(&whole).as_deref(), Some("Adobe RGB (1998)"));
            (0..whole.len()).for_each(|n| assert_eq!(description(&whole[..n]), None, "{n}"));
        }
        assert!(is_srgb("sRGB IEC61966-2.1") && !is_srgb("Display P3"));
    }
}
