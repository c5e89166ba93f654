//! Combines all mutants of a file in one text, each behind its own switch.

use std::collections::BTreeMap;
use std::ops::Range;

use proc_macro2::Span;
use syn::spanned::Spanned as _;
use syn::visit::{self, Visit};

use crate::list::{Extent, Mutant, Position};

/// Code that is added to every woven crate. It tells whether the environment turns the switch of a given number on.
pub const SWITCH: &str = "\npub(crate) mod mutant_switch {
    pub(crate) fn on(number: usize) -> bool {
        static THROWN: std::sync::LazyLock<usize> = std::sync::LazyLock::new(|| {
            std::env::var(\"FEMC_MUTANT\").ok().and_then(|number| number.parse().ok()).unwrap_or(0)
        });
        *THROWN == number
    }
}\n";

/// A woven text, with the byte ranges of its mutants.
#[derive(Debug, Default)]
pub struct WovenSource {
    pub text: String,
    pub origins: Vec<(Range<usize>, usize)>,
    /// Numbers of the mutants in the text.
    pub mutants: Vec<usize>,
}

/// A replacement of a part of the source.
#[derive(Debug, Clone)]
struct Edit {
    number: usize,
    at: Range<usize>,
    pieces: Vec<Piece>,
}

#[derive(Debug, Clone)]
enum Piece {
    New(String),
    /// Part of the source, with the other edits applied to it.
    Old(Range<usize>),
}

/// Weaves the mutants of a file into its source. Skips mutants whose position is not found.
/// - `mutants`: with their numbers, from 1.
pub fn weave(source: &str, mutants: &[(usize, &Mutant)]) -> syn::Result<WovenSource> {
    let file = syn::parse_file(source)?;
    let mut sites = MutationSites::default();
    sites.visit_file(&file);
    let edits: Vec<Edit> = mutants.iter().filter_map(|(number, mutant)| sites.edit(source, *number, mutant)).collect();
    let mut woven = WovenSource { mutants: edits.iter().map(|edit| edit.number).collect(), ..WovenSource::default() };
    woven.render(source, 0..source.len(), &edits.iter().collect::<Vec<_>>());
    Ok(woven)
}

impl WovenSource {
    fn render(&mut self, source: &str, at: Range<usize>, edits: &[&Edit]) {
        let mut from = at.start;
        // Outermost edits first. Of two edits at one position, one contains the other.
        let mut inside: Vec<&Edit> =
            edits.iter().filter(|edit| at.start <= edit.at.start && edit.at.end <= at.end).copied().collect();
        inside.sort_by_key(|edit| (edit.at.start, std::cmp::Reverse(edit.at.end), edit.number));
        for edit in &inside {
            if edit.at.start < from {
                continue;
            }
            self.text.push_str(&source[from..edit.at.start]);
            let begin = self.text.len();
            let others: Vec<&Edit> = inside.iter().filter(|other| other.number != edit.number).copied().collect();
            for piece in &edit.pieces {
                match piece {
                    Piece::New(text) => self.text.push_str(text),
                    Piece::Old(part) => self.render(source, part.clone(), &others),
                }
            }
            self.origins.push((begin..self.text.len(), edit.number));
            // An insertion replaces nothing, so more edits may follow at the same position.
            from = edit.at.end;
        }
        self.text.push_str(&source[from..at.end]);
    }

    /// Returns the innermost mutant that a byte comes from.
    pub fn origin(&self, byte: usize) -> Option<usize> {
        let around = self.origins.iter().filter(|(range, _)| range.contains(&byte));
        around.min_by_key(|(range, _)| range.len()).map(|&(_, number)| number)
    }
}

/// Parts of a file that can be mutated, by position.
#[derive(Debug, Default)]
struct MutationSites {
    /// Bodies of functions, except functions that return `impl Trait`: only their body knows the type.
    bodies: Vec<Range<usize>>,
    /// Left operand, right operand and whole expression, by position of the operator.
    binary: BTreeMap<usize, [Range<usize>; 3]>,
    /// Operand and whole expression, by position of the operator.
    unary: BTreeMap<usize, [Range<usize>; 2]>,
    /// Pattern and guard, by position of the match arm.
    arms: BTreeMap<usize, (Range<usize>, Option<Range<usize>>)>,
    guards: Vec<Range<usize>>,
    /// Field up to the next field, and whole expression, by position of the field.
    fields: BTreeMap<usize, [Range<usize>; 2]>,
}

fn byte_range(span: Span) -> Range<usize> {
    span.byte_range()
}

impl<'ast> Visit<'ast> for MutationSites {
    fn visit_item_fn(&mut self, item: &'ast syn::ItemFn) {
        self.body(&item.sig, &item.block);
        visit::visit_item_fn(self, item);
    }

    fn visit_impl_item_fn(&mut self, item: &'ast syn::ImplItemFn) {
        self.body(&item.sig, &item.block);
        visit::visit_impl_item_fn(self, item);
    }

    fn visit_trait_item_fn(&mut self, item: &'ast syn::TraitItemFn) {
        item.default.iter().for_each(|block| self.body(&item.sig, block));
        visit::visit_trait_item_fn(self, item);
    }

    fn visit_expr_binary(&mut self, expr: &'ast syn::ExprBinary) {
        // A condition that contains `let` cannot be put into parentheses.
        if !has_let(&expr.left) && !has_let(&expr.right) {
            let parts = [expr.left.span(), expr.right.span(), expr.span()].map(byte_range);
            self.binary.insert(byte_range(expr.op.span()).start, parts);
        }
        visit::visit_expr_binary(self, expr);
    }

    fn visit_expr_unary(&mut self, expr: &'ast syn::ExprUnary) {
        self.unary.insert(byte_range(expr.op.span()).start, [expr.expr.span(), expr.span()].map(byte_range));
        visit::visit_expr_unary(self, expr);
    }

    fn visit_arm(&mut self, arm: &'ast syn::Arm) {
        let guard = arm.guard.as_ref().map(|(_, guard)| guard);
        if guard.is_none_or(|guard| !has_let(guard)) {
            let guard = guard.map(|guard| byte_range(guard.span()));
            self.guards.extend(guard.clone());
            self.arms.insert(byte_range(arm.span()).start, (byte_range(arm.pat.span()), guard));
        }
        visit::visit_arm(self, arm);
    }

    fn visit_expr_struct(&mut self, expr: &'ast syn::ExprStruct) {
        if expr.rest.is_some() {
            for pair in expr.fields.pairs() {
                let field = byte_range(pair.value().span());
                let end = pair.punct().map_or(field.end, |comma| byte_range(comma.span()).end);
                self.fields.insert(field.start, [field.start..end, byte_range(expr.span())]);
            }
        }
        visit::visit_expr_struct(self, expr);
    }
}

fn has_let(expr: &syn::Expr) -> bool {
    match expr {
        syn::Expr::Let(_) => true,
        syn::Expr::Binary(binary) => has_let(&binary.left) || has_let(&binary.right),
        _ => false,
    }
}

impl MutationSites {
    fn body(&mut self, signature: &syn::Signature, block: &syn::Block) {
        if !matches!(&signature.output, syn::ReturnType::Type(_, of) if matches!(**of, syn::Type::ImplTrait(_))) {
            self.bodies.push(byte_range(block.span()));
        }
    }

    fn edit(&self, source: &str, number: usize, mutant: &Mutant) -> Option<Edit> {
        let Extent { start, end } = mutant.extent;
        let (start, end) = (byte_offset(source, start)?, byte_offset(source, end)?);
        let on = format!("crate::mutant_switch::on({number})");
        let new = |text: String| Piece::New(text);
        let replacement = &mutant.replacement;
        let (at, pieces) = match mutant.genre.as_str() {
            "FnValue" => {
                // The extent covers the body with or without its braces.
                let body = self.bodies.iter().filter(|body| body.start <= start && end <= body.end);
                let body = body.min_by_key(|body| body.len()).filter(|body| is_whole_body(source, body, start..end))?;
                let first = body.start + 1;
                (first..first, vec![new(format!(" if {on} {{ return {replacement}; }} "))])
            }
            "BinaryOperator" => {
                let [left, right, all] = self.binary.get(&start)?.clone();
                let pieces = vec![
                    new(format!("(if {on} {{ ")),
                    Piece::Old(left),
                    new(format!(" {replacement} ")),
                    Piece::Old(right),
                    new(" } else { ".into()),
                    Piece::Old(all.clone()),
                    new(" })".into()),
                ];
                (all, pieces)
            }
            "UnaryOperator" => {
                let [operand, all] = self.unary.get(&start)?.clone();
                let pieces = vec![
                    new(format!("(if {on} {{ {replacement}")),
                    Piece::Old(operand),
                    new(" } else { ".into()),
                    Piece::Old(all.clone()),
                    new(" })".into()),
                ];
                (all, pieces)
            }
            "MatchArm" => {
                let (pattern, guard) = self.arms.get(&start)?.clone();
                match guard {
                    Some(guard) => {
                        let pieces = vec![new(format!("!{on} && (")), Piece::Old(guard.clone()), new(")".into())];
                        (guard, pieces)
                    }
                    None => (pattern.end..pattern.end, vec![new(format!(" if !{on}"))]),
                }
            }
            "MatchArmGuard" => {
                let guard = self.guards.iter().find(|guard| **guard == (start..end))?.clone();
                let pieces = vec![
                    new(format!("(if {on} {{ {replacement} }} else {{ ")),
                    Piece::Old(guard.clone()),
                    new(" })".into()),
                ];
                (guard, pieces)
            }
            "StructField" => {
                let [field, all] = self.fields.get(&start)?.clone();
                let pieces = vec![
                    new(format!("(if {on} {{ ")),
                    Piece::Old(all.start..field.start),
                    Piece::Old(field.end..all.end),
                    new(" } else { ".into()),
                    Piece::Old(all.clone()),
                    new(" })".into()),
                ];
                (all, pieces)
            }
            _ => return None,
        };
        Some(Edit { number, at, pieces })
    }
}

/// Checks whether this part of a body is everything between its braces.
fn is_whole_body(source: &str, body: &Range<usize>, part: Range<usize>) -> bool {
    let rest = [source.get(body.start + 1..part.start), source.get(part.end..body.end - 1)];
    rest.iter().all(|rest| rest.is_none_or(|rest| rest.trim().is_empty() || rest.trim_start().starts_with("//")))
}

/// Converts a position to a byte offset. Columns count characters from 1.
fn byte_offset(source: &str, position: Position) -> Option<usize> {
    let start = match position.line {
        1 => 0,
        line => source.match_indices('\n').nth(line - 2)?.0 + 1,
    };
    let offset: usize = source[start..].chars().take(position.column - 1).map(char::len_utf8).sum();
    Some(start + offset)
}
