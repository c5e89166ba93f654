//! Suggestions for a mistyped name.

/// Returns the three `names` with the least edit distance to `wanted`, nearest first; equal distances keep their order.
pub fn nearest(wanted: &str, names: &[String]) -> Vec<String> {
    let mut ranked: Vec<(usize, &String)> = names.iter().map(|name| (distance(wanted, name), name)).collect();
    ranked.sort_by_key(|entry| entry.0);
    ranked.into_iter().take(3).map(|(_, name)| name.clone()).collect()
}

/// Returns the edit distance that counts inserted, deleted, changed and transposed neighboring letters (optimal string alignment
/// \[boytsov2011\]).
fn distance(a: &str, b: &str) -> usize {
    let (a, b): (Vec<char>, Vec<char>) = (a.chars().collect(), b.chars().collect());
    let mut two_back = vec![0; b.len() + 1];
    let mut back: Vec<usize> = (0..=b.len()).collect();
    for i in 1..=a.len() {
        let mut row = vec![i; b.len() + 1];
        for j in 1..=b.len() {
            let changed = usize::from(a[i - 1] != b[j - 1]);
            row[j] = (back[j] + 1).min(row[j - 1] + 1).min(back[j - 1] + changed);
            if i > 1 && j > 1 && a[i - 1] == b[j - 2] && a[i - 2] == b[j - 1] {
                row[j] = row[j].min(two_back[j - 2] + 1);
            }
        }
        two_back = std::mem::replace(&mut back, row);
    }
    back[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn distance_counts_letters_added_dropped_changed_and_swapped() {
        for (a, b, expected) in [
            ("", "", 0),
            ("fog", "fog", 0),
            ("", "fog", 3),
            ("fog", "frog", 1),
            ("frog", "fog", 1),
            ("fog", "dog", 1),
            ("lmap", "lamp", 1),
            ("kitten", "sitting", 3),
        ] {
            assert_eq!(distance(a, b), expected, "{a} to {b}");
        }
    }
}
