//! Tests with expressions from the manuals of other renderers: each is parsed with its meaning, or refused with advice about the
//! construct.

use femc_layers::{Expression, LayerError};

/// Expected outcome of parsing an expression.
enum Outcome {
    /// The expression means the same as this one.
    Same(&'static str),
    /// The expression is refused at a character, counted from 0, with advice that contains this text.
    Refused(usize, &'static str),
}
use Outcome::{Refused, Same};

const TABLE: &[(&str, Outcome)] = &[
    // The prefix of RenderMan, and the type before it.
    ("lpe:C<RD><L.>", Same("C<RD>L")),
    ("LPE:C<RD>L", Same("C<RD>L")),
    (" lpe: C.*L", Same("C.*L")),
    ("color lpe:C.*[LO]", Same("C.*[LO]")),
    ("Color LPE:C.*", Same("C.*")),
    ("lpe:C.*<L.'key'>", Same("C.*<L.'key'>")),
    ("C.*<L.'lpe:key'>", Same(r"C.*<L.'lpe:key'>")),
    ("float lpe:C.*", Refused(0, "leave it out")),
    ("unoccluded;lpe:C<RD>L", Refused(0, "unoccluded")),
    ("noclamp;unoccluded;overwrite;lpe:C<.D><L.>", Refused(0, "noclamp")),
    ("color noinfinitecheck;lpe:C<.D><L.>", Refused(0, "leave it out")),
    // RenderMan's own outputs.
    ("C<.S'subsurface'>*<L.>", Same("C[GS]*L")),
    ("C<RD>[<L.>O]", Same("C<RD>[LO]")),
    ("C<RD>[DS]+[<L.>O]", Same("C<RD>[DS]+[LO]")),
    ("C<RS>[DS]+<L.'group'>", Same("C<RS>[DS]+<L.'group'>")),
    ("C(U2L)|O", Refused(2, "`U`")),
    ("CD1L", Refused(2, "not numbered")),
    ("CU6[<L.>O]", Refused(1, "`U`")),
    // Arnold, Karma, V-Ray, MoonRay.
    ("C<RD>A", Refused(5, "albedo")),
    ("C[^<TD>]A", Refused(8, "albedo")),
    ("C<RS[^'coat']>.*", Same("C<RS[^'coat']>.*")),
    ("C.*[LO]", Same("C.*[OL]")),
    ("C.*<L.[^'key']>", Same("C.*<L.[^'key']>")),
    ("CVL", Same("C<V.>L")),
    ("C[DS]{2}L", Same("C[DS][DS]L")),
    ("CD{1,3}L", Same("CDD?D?L")),
    ("C(D|S){2}L", Same("C(D|S)(D|S)L")),
    ("CD{0,2}L", Same("CD?D?L")),
    ("CD{3,1}L", Refused(2, "{n,m}")),
    ("CD{0}L", Refused(2, "{n,m}")),
    ("CD{2,}L", Refused(5, "{n,m}")),
    ("CD{99}L", Refused(2, "64")),
    ("C{D}L", Refused(2, "{n,m}")),
    ("C((D{64}){64}){64}L", Refused(9, "2048")),
    // Iray, mental ray.
    ("E.*L", Refused(0, "`C`, which is the camera")),
    ("E<RD>Le", Refused(0, "`C`")),
    // Open Shading Language.
    ("C<TS>+<RD>L", Same("C<TS>+<RD>L")),
    ("C<Ts>*L", Refused(3, "straight through")),
    ("Cs*L", Refused(1, "straight through")),
    ("C<.D>L", Same("CDL")),
    ("C<RD.>L", Same("C<RD>L")),
    ("C<R.>L", Same("CRL")),
    ("C<..'ball'>L", Same("C'ball'L")),
    ("C[^D]*L", Same("C[^D]*L")),
    ("C<D>L", Refused(2, "without angles")),
    ("C<[RT]D>L", Same("CDL")),
    ("C(<RD>|<TD>)L", Same("C(<RD>|<TD>)L")),
    // Typing errors.
    ("c<rd>l", Refused(0, "capitals")),
    ("Cdl", Refused(1, "capitals")),
    ("C<rD>L", Refused(2, "capitals")),
    ("C<Rd>L", Refused(3, "capitals")),
    ("C.*<L.\"key\">", Refused(6, "single quotes")),
    ("C.*<L.\u{2018}key\u{2019}>", Refused(6, "single quotes")),
    ("C.*<L.key>", Refused(6, "single quotes")),
    ("\"C.*\"", Refused(0, "single quotes")),
    ("C!DL", Refused(1, "[^..]")),
    ("C^DL", Refused(1, "within brackets")),
    ("C.*;D", Refused(3, "leave it out")),
    ("C.*&D", Refused(3, "`&`")),
    ("C[D!S]L", Refused(3, "[^..]")),
];

#[test]
fn other_renderers_dialects_keep_their_meaning_or_are_refused() {
    for (text, outcome) in TABLE {
        let found = Expression::parse(text);
        match outcome {
            Same(other) => {
                // RenderMan's `S` includes glossy scattering, so the trees differ. No material has this label, so a scene would
                // refuse it; parsing succeeds.
                if text.contains("subsurface") {
                    assert!(found.is_ok(), "{text}: {found:?}");
                    continue;
                }
                assert_eq!(normal(found.as_ref().unwrap_or_else(|e| panic!("{text}: {e}"))), normal(&parse(other)));
            }
            Refused(at, advice) => {
                let error = found.map(|it| panic!("{text} is read as {it:?}")).unwrap_or_else(|error| error);
                assert_eq!(error.position, *at, "{text}: {error}");
                assert!(error.to_string().contains(advice), "{text}: {error}");
            }
        }
    }
}

fn parse(text: &str) -> Expression {
    Expression::parse(text).unwrap_or_else(|e| panic!("{text}: {e}"))
}

/// Formats the tree with nested sequences joined and every event as its matching kinds and labels.
fn normal(expression: &Expression) -> String {
    fn walk(node: &femc_layers::Node) -> String {
        use femc_layers::Node::{Choice, Event, OneOrMore, Optional, Sequence, ZeroOrMore};
        match node {
            Event(event) => {
                format!("{:?} {:?};", event.kinds().collect::<Vec<_>>(), event.labels().collect::<Vec<_>>())
            }
            Sequence(all) => all.iter().map(walk).collect(),
            Choice(all) => format!("({})", all.iter().map(walk).collect::<Vec<_>>().join("|")),
            ZeroOrMore(node) => format!("({})*", walk(node)),
            OneOrMore(node) => format!("({})+", walk(node)),
            Optional(node) => format!("({})?", walk(node)),
        }
    }
    walk(expression.node())
}

#[test]
fn prefixed_layer_error_points_into_the_text_as_typed() {
    let error = "t=lpe:C<RX>L".parse::<femc_layers::Layer>().unwrap_err();
    let LayerError::Expression { cause, .. } = &error else { panic!("{error}") };
    assert_eq!((cause.position, cause.expression.as_str()), (7, "lpe:C<RX>L"));
    let text = error.to_string();
    let lines: Vec<&str> = text.lines().collect();
    assert_eq!(lines[1].find('X'), lines[2].find('^'), "{text}");
}
