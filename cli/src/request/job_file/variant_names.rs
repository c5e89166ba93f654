//! Names of variants, used as folder names.

use femc_model::Digest;
use std::collections::BTreeMap;

/// Longest name in bytes. Together with a frame's own name it fits every file system.
const MAX_LENGTH: usize = 120;

/// Returns a name for each list of texts. Names are safe on all file systems, and unique even if case is ignored. A plain name is a
/// function of its texts alone. If it is unsafe, too long or not unique, the name is changed and ends in a part of the digest of
/// the texts.
pub fn variant_names(rows: &[Vec<String>]) -> Vec<String> {
    let plain: Vec<String> = rows.iter().map(|row| row.join(",")).collect();
    let mut count: BTreeMap<String, u32> = BTreeMap::new();
    plain.iter().for_each(|name| *count.entry(name.to_lowercase()).or_default() += 1);
    let name = |plain: &String| {
        let safe: String = plain.chars().map(|c| if is_safe(c) { c } else { '_' }).collect();
        if safe == *plain && safe.len() <= MAX_LENGTH && count[&plain.to_lowercase()] == 1 {
            return safe;
        }
        let digest = Digest::compute(plain.as_bytes()).to_string();
        let cut = safe.char_indices().map(|(at, c)| at + c.len_utf8()).take_while(|&end| end <= MAX_LENGTH - 9).last();
        format!("{}~{}", &safe[..cut.unwrap_or(0)], &digest[..8])
    };
    plain.iter().map(name).collect()
}

fn is_safe(c: char) -> bool {
    c.is_ascii_alphanumeric() || "=,.+-_".contains(c)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn named(texts: &[&str]) -> Vec<String> {
        variant_names(&texts.iter().map(|text| vec![(*text).to_owned()]).collect::<Vec<_>>())
    }

    #[test]
    fn plain_texts_stay_as_they_are_and_others_get_a_digest() {
        let names = named(&["sigma_s=0.01", "camera=a/b", "camera=a_b", "camera=Main", "camera=main"]);
        assert_eq!((names[0].as_str(), names[2].as_str()), ("sigma_s=0.01", "camera=a_b"));
        assert!(names[1].starts_with("camera=a_b~"), "{names:?}");
        let mut lower: Vec<String> = names.iter().map(|name| name.to_lowercase()).collect();
        lower.sort();
        lower.dedup();
        assert_eq!(lower.len(), 5, "{names:?}");
    }

    #[test]
    fn long_names_are_cut_and_stay_different() {
        let [a, b] = ["x", "y"].map(|end| format!("camera={}{end}", "ä".repeat(200)));
        let names = named(&[&a, &b]);
        assert!(names.iter().all(|name| name.len() <= MAX_LENGTH) && names[0] != names[1], "{names:?}");
    }
}
