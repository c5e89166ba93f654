//! Range requests and conditional requests (RFC 9110, 13 and 14).

use std::ops::Range;

use ::http::HeaderMap;
use ::http::header::{IF_NONE_MATCH, IF_RANGE, RANGE};

/// Part of a file that a request asks for.
#[derive(Debug, Clone, PartialEq, Eq)]
pub(super) enum RequestedRange {
    /// The whole file.
    Whole,
    /// These bytes.
    Part(Range<u64>),
    /// A part that starts past the end.
    Unsatisfiable,
}

/// Returns the part of a file of `length` bytes that a request asks for. Several ranges, or a range of another form, give the whole
/// file, which the standard permits.
/// - `tag`: entity tag of the file, in quotes.
pub(super) fn requested_range(headers: &HeaderMap, length: u64, tag: &str) -> RequestedRange {
    let is_current = headers.get(IF_RANGE).is_none_or(|known| known.as_bytes() == tag.as_bytes());
    let range = headers.get(RANGE).filter(|_| is_current).and_then(|range| range.to_str().ok());
    range.and_then(|range| parse(range, length)).unwrap_or(RequestedRange::Whole)
}

fn parse(text: &str, length: u64) -> Option<RequestedRange> {
    let (unit, range) = text.trim().split_once('=')?;
    let (first, last) = range.trim().split_once('-')?;
    if !unit.trim().eq_ignore_ascii_case("bytes") {
        return None;
    }
    let number = |text: &str| {
        let is_number = !text.is_empty() && text.bytes().all(|digit| digit.is_ascii_digit());
        // A number with too many digits for the type lies past any end.
        is_number.then(|| text.parse().unwrap_or(u64::MAX))
    };
    let (begin, end) = if first.is_empty() {
        let count = number(last)?;
        if count == 0 {
            return Some(RequestedRange::Unsatisfiable);
        }
        (length.saturating_sub(count), length)
    } else {
        let begin = number(first)?;
        let end = if last.is_empty() { length } else { number(last)?.saturating_add(1) };
        if end <= begin && !last.is_empty() {
            return None;
        }
        (begin, end.min(length))
    };
    Some(if begin < length { RequestedRange::Part(begin..end) } else { RequestedRange::Unsatisfiable })
}

/// Returns whether the client already has the file with this tag.
pub(super) fn is_cached_by_client(headers: &HeaderMap, tag: &str) -> bool {
    let lists = headers.get_all(IF_NONE_MATCH).into_iter().filter_map(|list| list.to_str().ok());
    let mut tags = lists.flat_map(|list| list.split(','));
    tags.any(|known| matches!(known.trim(), "*") || known.trim().trim_start_matches("W/") == tag)
}

#[cfg(test)]
mod tests {
    use ::http::HeaderValue;

    use super::*;

    #[test]
    fn single_range_is_part_and_other_ranges_are_whole_or_beyond() {
        for (text, due) in [
            ("bytes=0-", RequestedRange::Part(0..10)),
            ("bytes=0-0", RequestedRange::Part(0..1)),
            ("bytes=3-5", RequestedRange::Part(3..6)),
            ("BYTES = 3-5", RequestedRange::Part(3..6)),
            ("bytes=3-99", RequestedRange::Part(3..10)),
            ("bytes=9-", RequestedRange::Part(9..10)),
            ("bytes=3-99999999999999999999999", RequestedRange::Part(3..10)),
            ("bytes=-4", RequestedRange::Part(6..10)),
            ("bytes=-99", RequestedRange::Part(0..10)),
            ("bytes=-0", RequestedRange::Unsatisfiable),
            ("bytes=10-", RequestedRange::Unsatisfiable),
            ("bytes=10-12", RequestedRange::Unsatisfiable),
            ("bytes=99999999999999999999999-", RequestedRange::Unsatisfiable),
            ("bytes=5-3", RequestedRange::Whole),
            ("bytes=0-1,3-4", RequestedRange::Whole),
            ("bytes=-", RequestedRange::Whole),
            ("bytes=+1-2", RequestedRange::Whole),
            ("bytes=a-b", RequestedRange::Whole),
            ("frames=1-2", RequestedRange::Whole),
            ("", RequestedRange::Whole),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(RANGE, HeaderValue::from_static(text));
            assert_eq!(requested_range(&headers, 10, "\"a\""), due, "{text}");
            headers.insert(IF_RANGE, HeaderValue::from_static("\"a\""));
            assert_eq!(requested_range(&headers, 10, "\"a\""), due, "{text} of the file that the client has");
            headers.insert(IF_RANGE, HeaderValue::from_static("\"b\""));
            assert_eq!(requested_range(&headers, 10, "\"a\""), RequestedRange::Whole, "{text} of another file");
        }
        let mut headers = HeaderMap::new();
        headers.insert(RANGE, HeaderValue::from_static("bytes=0-"));
        assert_eq!(requested_range(&headers, 0, "\"a\""), RequestedRange::Unsatisfiable, "an empty file has no part");
    }

    #[test]
    fn a_tag_is_known_alone_or_in_a_list_and_weak_or_strong() {
        for (text, due) in [
            ("\"a\"", true),
            ("W/\"a\"", true),
            ("\"b\", \"a\"", true),
            ("*", true),
            ("\"b\"", false),
            ("a", false),
            ("", false),
        ] {
            let mut headers = HeaderMap::new();
            headers.insert(IF_NONE_MATCH, HeaderValue::from_static(text));
            assert_eq!(is_cached_by_client(&headers, "\"a\""), due, "{text}");
        }
    }
}
