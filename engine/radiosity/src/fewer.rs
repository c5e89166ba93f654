//! Selection of a few items that represent many.

/// Selects items that represent all, with weights: at most `most` units of equal weight. A heavy item gets several units.
/// - `weight`: weight of an item; at least 0, finite;
/// - returns all items with their own weights if there are no more than `most`.
pub fn fewer<T: Copy>(items: &[T], most: usize, weight: impl Fn(&T) -> f64) -> Vec<(T, f64)> {
    if items.len() <= most {
        return items.iter().map(|item| (*item, weight(item))).collect();
    }
    let each = items.iter().map(&weight).sum::<f64>() / most as f64;
    let (mut out, mut sum, mut next) = (Vec::with_capacity(most), 0.0, 0.5 * each);
    for item in items {
        sum += weight(item);
        let number = if each > 0.0 { ((sum - next) / each).ceil().max(0.0) } else { 0.0 };
        if number > 0.0 {
            next += number * each;
            out.push((*item, number * each));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_have_the_weight_of_all_and_heavy_ones_stand_for_more() {
        let items: Vec<u32> = (0..1000).collect();
        let weight = |item: &u32| if *item == 17 { 500.0 } else { 1.0 };
        let out = fewer(&items, 64, weight);
        let whole: f64 = out.iter().map(|(_, weight)| weight).sum();
        assert!(out.len() <= 64 && (whole / 1499.0 - 1.0).abs() < 1e-9, "{} {whole}", out.len());
        let heavy = out.iter().find(|(item, _)| *item == 17).expect("the heavy one").1;
        assert!((heavy - 500.0).abs() < 2.0 * 1499.0 / 64.0, "{heavy}");
        assert_eq!(fewer(&items[..3], 64, weight), [(0, 1.0), (1, 1.0), (2, 1.0)]);
        assert!(fewer(&items, 64, |_| 0.0).is_empty());
    }
}
