//! Light path expressions in the notation of other renderers: accepted constructs, and advice for the others.
//!
//! Users paste expressions from the manuals of Arnold, Karma, RenderMan, Iray and others. A construct with the same meaning is
//! accepted. Every other construct is refused with its position and the notation to use here, because a layer that silently takes
//! other light is worse than an error.

/// Returns the length in characters of a prefix of other renderers: `lpe:`, or `color lpe:`, in any case.
/// - errors: position and advice, if other words precede `lpe:`.
pub(crate) fn prefix(chars: &[char]) -> Result<usize, (usize, &'static str)> {
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

const OPTIONS: &str = "the expression alone: what other renderers write before `lpe:` (float, unoccluded; noclamp; overwrite; ..) has no \
                       counterpart here; leave it out";

/// Returns advice about a character that begins no event here but has a meaning in another renderer.
pub(crate) fn advice(found: char) -> Option<&'static str> {
    Some(match found {
        's' => {
            "no `s`: what goes straight through a clear surface makes no event here; leave it out (a mirror is `S`, in capitals)"
        }
        'c' | 'r' | 't' | 'v' | 'd' | 'g' | 'l' | 'o' | 'b' => {
            "an event in capitals, one of C R T V D G S L O B: lower case has no meaning here"
        }
        'A' => "no `A`: albedo is no light; write [LOB] for any source, or use `--layers albedo`",
        'E' => "`C`, which is the camera (the eye, `E`, of other renderers)",
        'U' => "no `U`: there are no lobes of users; the scatterings are D (diffuse), G (rough gloss) and S (mirror)",
        '0'..='9' => "no number: lobes are not numbered here; write D, G or S alone",
        '"' | '\u{2018}' | '\u{2019}' | '\u{201c}' | '\u{201d}' | '`' => {
            "an event, or a label in straight single quotes, like 'desk.lamp'"
        }
        ';' | ':' => OPTIONS,
        '{' => "an event before the repetition `{..}`",
        '^' => "`^` within brackets only, like [^D]",
        '!' | '~' => "`[^..]` for any event but these, like [^D]",
        '&' => "no `&`: paths that fit two expressions cannot be asked for; write one expression",
        _ => return None,
    })
}

/// Advice about a scattering in the position of the type: `<D>`.
pub(crate) const SCATTERING_FIRST: &str =
    "the type before the scattering: write D, G or S without angles, or <RD>, <TD>, <.D> ..";

/// Advice about a label without quotes: `<L.key>`.
pub(crate) const BARE_LABEL: &str = "`>`, or a label in straight single quotes, like <L.'key'>";
