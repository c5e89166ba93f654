//! Light path expressions in the notation of other renderers: accepted constructs, and advice for the others.
//!
//! Users paste expressions from the manuals of Arnold, Karma, RenderMan, Iray and others. A construct with the same meaning is
//! accepted. Every other construct is refused with its position and the notation to use here, because a layer that silently takes
//! other light is worse than an error.

/// Returns the length in characters of a prefix of other renderers: `lpe:`, or `color lpe:`, in any case.
/// - errors: position and advice, if other words precede `lpe:`.
pub(crate) fn prefix_length(chars: &[char]) -> Result<usize, (usize, &'static str)> {
    const PREFIX: [char; 4] = ['l', 'p', 'e', ':'];
    let is_prefix = |window: &[char]| window.iter().map(char::to_ascii_lowercase).eq(PREFIX);
    let Some(at) = chars.windows(PREFIX.len()).position(is_prefix) else { return Ok(0) };
    let before = &chars[..at];
    // A label may contain any text.
    if before.iter().any(|c| matches!(c, '\'' | '<' | '[' | '(')) {
        return Ok(0);
    }
    let words: String = before.iter().collect();
    match words.trim().to_ascii_lowercase().as_str() {
        "" | "color" => Ok(at + PREFIX.len()),
        _ => {
            let first = before.iter().position(|c| !c.is_whitespace()).unwrap_or(0);
            Err((first, OPTIONS))
        }
    }
}

const OPTIONS: &str = "only the expression: options that other renderers write before `lpe:` (float, unoccluded; noclamp; overwrite; ..) do not \
                       exist here; leave it out";

/// Returns advice about a character that begins no event here but has a meaning in another renderer.
pub(crate) fn advice(found: char) -> Option<&'static str> {
    Some(match found {
        's' => {
            "an event: light that goes straight through a clear surface makes no event here; leave it out (a mirror is a capital `S`)"
        }
        'c' | 'r' | 't' | 'v' | 'd' | 'g' | 'l' | 'o' | 'b' => {
            "an event in capitals, one of C R T V D G S L O B: lower-case letters have no meaning here"
        }
        'A' => "an event: albedo is not light; write [LOB] for any source, or use `--layers albedo`",
        'E' => "`C`, which is the camera (other renderers write `E` for eye)",
        'U' => {
            "an event: user lobes (`U`) do not exist here; the scatterings are D (diffuse), G (rough gloss) and S (mirror)"
        }
        '0'..='9' => "an event: lobes are not numbered here; write D, G or S without a number",
        '"' | '\u{2018}' | '\u{2019}' | '\u{201c}' | '\u{201d}' | '`' => {
            "an event, or a label in straight single quotes, like 'desk.lamp'"
        }
        ';' | ':' => OPTIONS,
        '{' => "an event before the repetition `{..}`",
        '^' => "`^` only within brackets, like [^D]",
        '!' | '~' => "`[^..]` for any event except these, like [^D]",
        '&' => "a single expression: `&`, for paths that match two expressions, does not exist here",
        _ => return None,
    })
}

/// Advice about a scattering in the position of the type: `<D>`.
pub(crate) const SCATTERING_FIRST: &str =
    "the type before the scattering: write D, G or S without angles, or <RD>, <TD>, <.D> ..";

/// Advice about a label without quotes: `<L.key>`.
pub(crate) const BARE_LABEL: &str = "`>`, or a label in straight single quotes, like <L.'key'>";
