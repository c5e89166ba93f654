//! Encodings and line ends of text files: scenes, photometric files and tilt files.
//!
//! Text is UTF-8 or another encoding that extends ASCII; its bytes are used unchanged. UTF-16 is recognized by a byte order mark,
//! or without one if zero bytes at every second position leave no doubt. A lone CR (old Macs), CRLF and LF each end a line, also
//! mixed in one file, so that line numbers match those of an editor. CRs before an LF belong to its line end, because some programs
//! write CRCRLF. Zero bytes and ^Z at the end are padding of old systems. Any other zero byte means that the file is not text.

use crate::ImportFault;

/// ^Z, which ends a text file in CP/M and DOS.
const END_OF_FILE: u8 = 0x1a;
/// Maximum number of characters of a file's text in a message.
const MAX_EXCERPT: usize = 64;

/// Decodes a file to bytes whose lines end with LF, without a byte order mark.
/// - `path`: name of the file for the fault.
pub(crate) fn decode(path: &str, bytes: Vec<u8>) -> Result<Vec<u8>, ImportFault> {
    let bad = |reason: String| ImportFault::BadFile {
        path: path.to_owned(),
        reason,
        advice: "check that it is the right file, and save it as plain text (UTF-8)",
    };
    let text = match &bytes[..] {
        [0xff, 0xfe, 0, 0, ..] | [0, 0, 0xfe, 0xff, ..] => return Err(bad("the file is UTF-32 text".into())),
        [0xff, 0xfe, rest @ ..] => utf16(rest, u16::from_le_bytes).map_err(bad)?,
        [0xfe, 0xff, rest @ ..] => utf16(rest, u16::from_be_bytes).map_err(bad)?,
        [0xef, 0xbb, 0xbf, rest @ ..] => rest.to_vec(),
        _ => unmarked_utf16(&bytes).unwrap_or(bytes),
    };
    let text = line_ends(without_padding(text));
    match text.iter().position(|&byte| byte == 0) {
        Some(at) => {
            let line = 1 + text[..at].iter().filter(|&&byte| byte == b'\n').count();
            Err(bad(format!("the file has a zero byte in line {line}, so it is not a text file")))
        }
        None => Ok(text),
    }
}

/// Returns the start of a text for a message, without control characters and with `...` after the first 64 characters.
pub(crate) fn excerpt(text: &[u8]) -> String {
    let characters = text.utf8_chunks().flat_map(|chunk| {
        let broken = (!chunk.invalid().is_empty()).then_some('\u{fffd}');
        chunk.valid().chars().chain(broken)
    });
    let mut characters = characters.filter(|character| !character.is_control());
    let mut start: String = characters.by_ref().take(MAX_EXCERPT).collect();
    if characters.next().is_some() {
        start.push_str("...");
    }
    start
}

/// Converts UTF-16 to UTF-8; the error is a reason.
fn utf16(bytes: &[u8], unit: fn([u8; 2]) -> u16) -> Result<Vec<u8>, String> {
    let (pairs, rest) = bytes.as_chunks::<2>();
    if rest.iter().any(|byte| *byte != 0 && !byte.is_ascii_whitespace()) {
        return Err("the file is UTF-16 text that ends inside a character".into());
    }
    let mut text = String::with_capacity(bytes.len() / 2);
    for character in char::decode_utf16(pairs.iter().map(|pair| unit(*pair))) {
        match character {
            Ok(character) => text.push(character),
            Err(_) => {
                let line = 1 + text.matches('\n').count();
                return Err(format!("the file is UTF-16 text with an invalid character in line {line}"));
            }
        }
    }
    Ok(text.into_bytes())
}

/// Decodes UTF-16 without a byte order mark. It must have zero bytes at only one parity, at half of those positions or more, and no
/// control characters but blanks.
fn unmarked_utf16(bytes: &[u8]) -> Option<Vec<u8>> {
    let padding = bytes.iter().rev().take_while(|&&byte| matches!(byte, 0 | END_OF_FILE)).count();
    let body = &bytes[..bytes.len() - padding];
    if !body.contains(&0) {
        return None;
    }
    let zeros = |parity: usize| body.iter().skip(parity).step_by(2).filter(|&&byte| byte == 0).count();
    let unit = match [zeros(0), zeros(1)] {
        [0, odd] if 2 * odd >= body.len() / 2 => u16::from_le_bytes,
        [even, 0] if 2 * even >= body.len() / 2 => u16::from_be_bytes,
        _ => return None,
    };
    let mut body = body.to_vec();
    if body.len() % 2 == 1 {
        // The padding included the high byte of the last character of little-endian text.
        body.push(0);
    }
    let text = utf16(&body, unit).ok()?;
    let control = |byte: &u8| byte.is_ascii_control() && !byte.is_ascii_whitespace() && !matches!(byte, 0x0b | 0x1a);
    (!text.iter().any(control)).then_some(text)
}

/// Removes trailing zero bytes and ^Z, with the blanks between them.
fn without_padding(mut text: Vec<u8>) -> Vec<u8> {
    let padding = |byte: u8| matches!(byte, 0 | END_OF_FILE);
    let tail = text.iter().rev().take_while(|&&byte| padding(byte) || byte.is_ascii_whitespace()).count();
    let start = text.len() - tail;
    if let Some(first) = text[start..].iter().position(|&byte| padding(byte)) {
        text.truncate(start + first);
    }
    text
}

/// Converts every line end to LF.
fn line_ends(text: Vec<u8>) -> Vec<u8> {
    if !text.contains(&b'\r') {
        return text;
    }
    let mut out = Vec::with_capacity(text.len());
    let mut at = 0;
    while at < text.len() {
        let returns = text[at..].iter().take_while(|&&byte| byte == b'\r').count();
        at += returns;
        // CRs before an LF belong to it.
        if returns > 0 && text.get(at) != Some(&b'\n') {
            out.resize(out.len() + returns, b'\n');
        }
        let plain = text[at..].iter().position(|&byte| byte == b'\r').unwrap_or(text.len() - at);
        out.extend_from_slice(&text[at..at + plain]);
        at += plain;
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn read(bytes: &[u8]) -> Result<String, String> {
        let text = decode("a.txt", bytes.to_vec()).map_err(|fault| fault.to_string())?;
        Ok(String::from_utf8_lossy(&text).into_owned())
    }

    fn wide(text: &str, bytes_of: fn(u16) -> [u8; 2]) -> Vec<u8> {
        text.encode_utf16().flat_map(bytes_of).collect()
    }

    #[test]
    fn every_line_end_is_one_line_end() {
        assert_eq!(read(b"a\nb\r\nc\rd\r\re\r\r\nf\n\rg\r").unwrap(), "a\nb\nc\nd\n\ne\nf\n\ng\n");
        assert_eq!(read(b"").unwrap(), "");
        assert_eq!(read(b"\r").unwrap(), "\n");
    }

    #[test]
    fn excerpts_are_truncated_and_drop_control_characters() {
        assert_eq!(excerpt(b"caf\xe9 \xc3\xa9 \x1b[1m\tend"), "caf\u{fffd} \u{e9} [1mend");
        assert_eq!(excerpt("\u{4e00}".repeat(64).as_bytes()), "\u{4e00}".repeat(64));
        assert_eq!(excerpt("\u{4e00}".repeat(65).as_bytes()), "\u{4e00}".repeat(64) + "...");
    }

    #[test]
    fn marks_and_padding_go() {
        assert_eq!(read(b"\xef\xbb\xbfa\n\0\0\x1a \n\0").unwrap(), "a\n");
        assert_eq!(read(b"a \n \x1a").unwrap(), "a \n ");
        assert_eq!(read(b"caf\xe9\n").unwrap(), "caf\u{fffd}\n", "another encoding is not looked at");
    }

    #[test]
    fn files_that_are_not_text_are_refused_by_name() {
        for (bytes, says) in [
            (&b"a\nb\0c\n"[..], "zero byte in line 2"),
            (b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "zero byte in line 3"),
            (b"\xff\xfea\0\n\0\0\xd8b\0", "invalid character in line 2"),
            (b"\xfe\xff\0ab", "ends inside a character"),
            (b"\xff\xfe\0\0a\0\0\0", "UTF-32"),
            (b"a\0\0\0b\0\0\0", "zero byte in line 1"),
            (b"a\0\x01\0b\0", "zero byte in line 1"),
        ] {
            let error = read(bytes).unwrap_err();
            assert!(error.contains(says) && error.contains("save it as plain text"), "{error}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig { cases: 500, failure_persistence: None, ..ProptestConfig::default() })]

        /// A text of any characters is preserved in every encoding with a mark, and in UTF-16 without a mark if it is ASCII.
        #[test]
        fn encodings_read_back(text in "[ -~\n\tà-ÿ一-三]{0,60}", plain in "[ -~\n\t]{1,60}") {
            let marked = format!("\u{feff}{text}");
            prop_assert_eq!(&read(text.as_bytes()).unwrap(), &text);
            prop_assert_eq!(&read(marked.as_bytes()).unwrap(), &text);
            prop_assert_eq!(&read(&wide(&marked, u16::to_le_bytes)).unwrap(), &text);
            prop_assert_eq!(&read(&wide(&marked, u16::to_be_bytes)).unwrap(), &text);
            prop_assert_eq!(&read(&wide(&plain, u16::to_le_bytes)).unwrap(), &plain);
            prop_assert_eq!(&read(&wide(&plain, u16::to_be_bytes)).unwrap(), &plain);
        }

        /// A decoded text has no zero byte and no CR, for any file.
        #[test]
        fn any_bytes_are_text_or_refused(bytes: Vec<u8>) {
            if let Ok(text) = decode("a.txt", bytes) {
                prop_assert!(!text.contains(&0) && !text.contains(&b'\r'));
            }
        }
    }
}
