/**
 * The text of a selection: conditions on paths, in the language of `femc paths --where` (engine/paths/src/query). The page splits a
 * text into terms and writes terms. It never evaluates a condition: the server does.
 */

export type Join = 'and' | 'or';
/** `any` and `all` intersections; `light` and `lights`: any and all lights. */
export type Quantifier = 'any' | 'all' | 'light' | 'lights';
export type CompareOp = '==' | '!=' | '<' | '<=' | '>' | '>=';

/** Terms joined by `and` and `or`. `and` binds tighter, so this is a union of intersections. */
export interface Chain {
  terms: Term[];
  /** One fewer than terms. */
  joins: Join[];
}

export interface Term {
  /** Whether an odd number of `not` stands before the body. */
  negated: boolean;
  body: Body;
  /** Start and end of the body in the text. */
  start: number;
  end: number;
}

export type Body =
  | { kind: 'group'; word: Quantifier | null; chain: Chain }
  | { kind: 'compare'; field: string; op: CompareOp; value: string }
  | { kind: 'sequence'; names: string[] }
  | { kind: 'box'; numbers: number[] }
  | { kind: 'lasso'; numbers: number[] };

/** Reason why a text is not a condition. */
export class TextError extends Error {
  constructor(
    /** Column in the text, from 1. */
    readonly column: number,
    message: string,
  ) {
    super(`column ${column}: ${message}`);
  }
}

const WORD_FIELDS = new Set([
  ...['object', 'material', 'interaction', 'light', 'occluder', 'found', 'end'],
  ...['first.object', 'first.interaction', 'last.object', 'last.interaction', 'brightest.light'],
]);
/** Fields whose words are names: `room` matches `room.wall`, too. */
const NAME_FIELDS = new Set(
  ['object', 'material', 'light', 'occluder', 'first.object', 'last.object', 'brightest.light'],
);
const KEYWORDS = new Set(['and', 'or', 'not', 'then', 'in', 'any', 'all', 'light', 'lights']);
const QUANTIFIERS: readonly string[] = ['any', 'all', 'light', 'lights'];
const WORD = /[\p{Alphabetic}\p{N}._\-+/#:]/u;
const MOST_DEPTH = 64;

interface Token {
  text: string;
  start: number;
  end: number;
}

function tokenize(text: string): Token[] {
  const tokens: Token[] = [];
  const pattern = /\s+|"[^"]*"|[=!<>]+|[\p{Alphabetic}\p{N}._\-+/#:]+|[^]/uy;
  while (pattern.lastIndex < text.length) {
    const start = pattern.lastIndex;
    const found = pattern.exec(text)![0];
    if (found === '"') throw new TextError(start + 1, 'the closing quotation mark is missing');
    if (found.trim()) tokens.push({ text: found, start, end: pattern.lastIndex });
  }
  return tokens;
}

class Parser {
  private at = 0;
  private depth = 0;
  private readonly tokens: Token[];

  constructor(private readonly text: string) {
    this.tokens = tokenize(text);
  }

  whole(): Chain {
    const chain = this.chain();
    if (this.at < this.tokens.length) this.fail('`and`, `or` or the end');
    return chain;
  }

  private is(word: string, ahead = 0): boolean {
    return this.tokens[this.at + ahead]?.text === word;
  }

  private accept(word: string): boolean {
    const takes = this.is(word);
    if (takes) this.at++;
    return takes;
  }

  private fail(expected: string): never {
    const token = this.tokens[this.at];
    const column = (token?.start ?? this.text.trimEnd().length) + 1;
    throw new TextError(column, `${token ? `found ${token.text}, ` : ''}expected ${expected}`);
  }

  private require(word: string) {
    if (!this.accept(word)) this.fail(`\`${word}\``);
  }

  private chain(): Chain {
    if (++this.depth > MOST_DEPTH) throw new TextError(1, `more than ${MOST_DEPTH} nested conditions`);
    const chain: Chain = { terms: [this.term()], joins: [] };
    for (;;) {
      const join = this.accept('and') ? 'and' : this.accept('or') ? 'or' : null;
      if (!join) break;
      chain.joins.push(join);
      chain.terms.push(this.term());
    }
    this.depth--;
    return chain;
  }

  private term(): Term {
    let negated = false;
    while (this.accept('not')) negated = !negated;
    const start = this.tokens[this.at]?.start ?? this.text.length;
    const body = this.body();
    return { negated, body, start, end: this.tokens[this.at - 1]!.end };
  }

  private body(): Body {
    if (this.is('(')) return this.group(null);
    const word = this.tokens[this.at]?.text ?? '';
    if (QUANTIFIERS.includes(word) && this.is('(', 1)) {
      this.at++;
      return this.group(word as Quantifier);
    }
    if (this.accept('in')) return this.region();
    if (this.is('then', 1)) {
      const names = [this.name()];
      while (this.accept('then')) names.push(this.name());
      return { kind: 'sequence', names };
    }
    return this.comparison();
  }

  private group(word: Quantifier | null): Body {
    this.require('(');
    const chain = this.chain();
    this.require(')');
    return { kind: 'group', word, chain };
  }

  private region(): Body {
    if (this.accept('box')) {
      const numbers = this.numbers();
      const isBox = numbers.length === 6 && [0, 1, 2].every((i) => numbers[i]! <= numbers[i + 3]!);
      if (!isBox) this.fail('six numbers in parentheses, the lower corner before the upper');
      return { kind: 'box', numbers };
    }
    if (!this.accept('lasso')) this.fail('`box` or `lasso`');
    const numbers = this.numbers();
    if (numbers.length < 6 || numbers.length % 2) this.fail('three or more points in parentheses, as X,Y,X,Y');
    return { kind: 'lasso', numbers };
  }

  private numbers(): number[] {
    this.require('(');
    const all = [this.number()];
    while (this.accept(',')) all.push(this.number());
    this.require(')');
    return all;
  }

  private number(): number {
    const value = parseNumber(this.tokens[this.at]?.text ?? '');
    if (value === null) this.fail('a number');
    this.at++;
    return value!;
  }

  private name(): string {
    const text = this.tokens[this.at]?.text;
    if (text === undefined || /^[()=!<>,]/.test(text)) this.fail('a word');
    this.at++;
    return text!.startsWith('"') ? text!.slice(1, -1) : text!;
  }

  private comparison(): Body {
    const field = this.tokens[this.at]?.text ?? '';
    const isKeyword = KEYWORDS.has(field) && !WORD_FIELDS.has(field);
    if (isKeyword || !/^\p{Alphabetic}/u.test(field)) this.fail('a name');
    this.at++;
    const op = this.tokens[this.at]?.text.replace(/^=$/, '==') ?? '';
    if (!['==', '!=', '<', '<=', '>', '>='].includes(op)) this.fail('`==`, `!=`, `<`, `<=`, `>` or `>=`');
    this.at++;
    const value = WORD_FIELDS.has(field) ? this.name() : String(this.number());
    return { kind: 'compare', field, op: op as CompareOp, value };
  }
}

const parseNumber = (text: string): number | null =>
  /^[+-]?(\d+\.?\d*|\.\d+)(e[+-]?\d+)?$/i.test(text) ? Number(text) : null;

/** Parses a condition; throws a [`TextError`]. */
export const parse = (text: string): Chain => new Parser(text).whole();

/** Returns a name or a word, in quotation marks unless it is a single token that no keyword equals. */
export function quote(text: string): string {
  const isPlain = /^\p{Alphabetic}/u.test(text) && [...text].every((c) => WORD.test(c)) && !KEYWORDS.has(text);
  return isPlain ? text : `"${text}"`;
}

/** Returns the names of objects, materials and lamps in a condition. */
export function namesIn(chain: Chain): string[] {
  return chain.terms.flatMap(({ body }) => {
    if (body.kind === 'compare') return NAME_FIELDS.has(body.field) ? [body.value] : [];
    if (body.kind === 'sequence') return body.names;
    return body.kind === 'group' ? namesIn(body.chain) : [];
  });
}

// ---- Chips

/** The selection as chips. */
export interface Chips {
  chips: Chip[];
  joins: Join[];
}

export type Chip = { negated: boolean } & (
  | {
      /** Condition on one field only. */
      kind: 'brush';
      field: string;
      chain: Chain;
      /** The condition without parentheses around it. */
      text: string;
    }
  | { kind: 'group'; word: Quantifier | null; inner: Chips }
  | { kind: 'term'; text: string; body: Body }
);

export type BrushChip = Extract<Chip, { kind: 'brush' }>;
export type GroupChip = Extract<Chip, { kind: 'group' }>;

/** Position of a chip: its number, and the numbers within groups. */
export type ChipPath = readonly number[];

export const NO_CHIPS: Chips = { chips: [], joins: [] };

/** Returns the one field that a chain compares, or null. */
function fieldOf(chain: Chain): string | null {
  let field: string | null = null;
  for (const { body } of chain.terms) {
    const here =
      body.kind === 'compare' ? body.field : body.kind === 'group' && body.word === null ? fieldOf(body.chain) : null;
    if (here === null || (field !== null && here !== field)) return null;
    field = here;
  }
  return field;
}

const chainText = (chain: Chain, text: string) => {
  const [first, last] = [chain.terms[0]!, chain.terms.at(-1)!];
  // A `not` stands before the body of the first term.
  const start = first.negated ? text.lastIndexOf('not', first.start - 1) : first.start;
  return text.slice(start, last.end);
};

/** Splits a condition into chips. */
export function toChips(text: string): Chips {
  if (!text.trim()) return NO_CHIPS;
  return split(parse(text), text);
}

function split(chain: Chain, text: string): Chips {
  const { terms, joins } = chain;
  // A union on one field is one chip, with or without parentheses around it.
  const field = joins.includes('or') ? fieldOf(chain) : null;
  if (field !== null) {
    return { chips: [{ kind: 'brush', negated: false, field, chain, text: chainText(chain, text) }], joins: [] };
  }
  const out: Chips = { chips: [], joins: [] };
  for (let i = 0; i < terms.length; i++) {
    if (i > 0) out.joins.push(joins[i - 1]!);
    const low = terms[i]!;
    const high = terms[i + 1];
    // A range is written as two terms.
    if (high && joins[i] === 'and' && isRange(low, high)) {
      const chain: Chain = { terms: [low, high], joins: ['and'] };
      const field = (low.body as { field: string }).field;
      out.chips.push({ kind: 'brush', negated: false, field, chain, text: text.slice(low.start, high.end) });
      i++;
      continue;
    }
    out.chips.push(chipOf(low, text));
  }
  return out;
}

function isRange(low: Term, high: Term): boolean {
  const [a, b] = [low.body, high.body];
  if (low.negated || high.negated || a.kind !== 'compare' || b.kind !== 'compare' || a.field !== b.field) return false;
  return a.op.startsWith('>') && b.op.startsWith('<');
}

function chipOf(term: Term, text: string): Chip {
  const { negated, body, start, end } = term;
  if (body.kind === 'compare') {
    const chain: Chain = { terms: [{ ...term, negated: false }], joins: [] };
    return { kind: 'brush', negated, field: body.field, chain, text: text.slice(start, end) };
  }
  if (body.kind !== 'group') return { kind: 'term', negated, text: text.slice(start, end), body };
  const { word, chain } = body;
  const field = word === null ? fieldOf(chain) : null;
  if (field !== null) return { kind: 'brush', negated, field, chain, text: chainText(chain, text) };
  return { kind: 'group', negated, word, inner: split(chain, text) };
}

/** Returns the text of chips. */
export function formatChips({ chips, joins }: Chips): string {
  return chips
    .map((chip, i) => {
      const join = i > 0 ? ` ${joins[i - 1]} ` : '';
      const isAlone = chips.length === 1;
      return `${join}${chip.negated ? 'not ' : ''}${chipText(chip, isAlone)}`;
    })
    .join('');
}

/** Returns the text of a chip without its `not`. */
function chipText(chip: Chip, isAlone: boolean): string {
  if (chip.kind === 'term') return chip.text;
  if (chip.kind === 'group') return `${chip.word ?? ''}(${formatChips(chip.inner)})`;
  const { terms, joins } = chip.chain;
  const isCompound = terms.length > 1 || terms[0]!.negated;
  const needs = chip.negated ? isCompound : joins.includes('or') && !isAlone;
  return needs ? `(${chip.text})` : chip.text;
}

/** Returns the chip at a position, or undefined. */
export function chipAt(all: Chips, path: ChipPath): Chip | undefined {
  const [first, ...rest] = path;
  const chip = all.chips[first!];
  if (!rest.length) return chip;
  return chip?.kind === 'group' ? chipAt(chip.inner, rest) : undefined;
}

/** Returns chips with one of them replaced; null removes it, and groups that become empty. */
export function withChip(all: Chips, [first, ...rest]: ChipPath, change: (chip: Chip) => Chip | null): Chips {
  const chip = all.chips[first!];
  if (!chip) return all;
  let next: Chip | null;
  if (!rest.length) next = change(chip);
  else if (chip.kind !== 'group') return all;
  else {
    const inner = withChip(chip.inner, rest, change);
    next = inner.chips.length ? { ...chip, inner } : null;
  }
  if (next) return { ...all, chips: all.chips.map((it, i) => (i === first ? next! : it)) };
  const chips = all.chips.filter((_, i) => i !== first);
  // A chip leaves with its `and`, if it has one, so that the others keep their meaning.
  const before = first! - 1;
  const gone = all.joins[before] === 'and' ? before : all.joins[first!] === 'and' ? first! : Math.max(before, 0);
  const [only] = chips;
  // A group that is left alone needs no parentheses.
  if (chips.length === 1 && only?.kind === 'group' && !only.word && !only.negated) return only.inner;
  return { chips, joins: all.joins.filter((_, i) => i !== gone) };
}

/** Switches between `and` and `or` before a chip. */
export function withJoin(all: Chips, [first, ...rest]: ChipPath): Chips {
  if (rest.length) {
    return withChip(all, [first!], (chip) => (chip.kind === 'group' ? { ...chip, inner: withJoin(chip.inner, rest) } : chip));
  }
  return { ...all, joins: all.joins.map((join, i) => (i === first! - 1 ? (join === 'and' ? 'or' : 'and') : join)) };
}

/** Switches between any and all intersections or lights. */
export function withOtherQuantifier(chip: Chip): Chip {
  const OTHER = { any: 'all', all: 'any', light: 'lights', lights: 'light' } as const;
  return chip.kind === 'group' && chip.word ? { ...chip, word: OTHER[chip.word] } : chip;
}

/** Adds a condition that must hold, too. Chips joined by `or` become a group first. */
export function withAlso(all: Chips, also: Chip): Chips {
  if (!all.chips.length) return { chips: [also], joins: [] };
  const grouped: Chips = all.joins.includes('or')
    ? { chips: [{ kind: 'group', negated: false, word: null, inner: all }], joins: [] }
    : all;
  return { chips: [...grouped.chips, also], joins: [...grouped.joins, 'and'] };
}

/** Adds a condition, as text, that must hold, too. */
export function withText(text: string, also: string): string {
  const added = toChips(also);
  const chip: Chip =
    added.chips.length === 1 ? added.chips[0]! : { kind: 'group', negated: false, word: null, inner: added };
  let before: Chips;
  try {
    before = toChips(text);
  } catch {
    // What the page cannot read stays as it is.
    return text.trim() ? `(${text}) and ${also}` : also;
  }
  // Several terms joined by `and` need no parentheses.
  if (added.chips.length > 1 && !added.joins.includes('or')) {
    return formatChips(added.chips.reduce((all, next) => withAlso(all, next), before));
  }
  return formatChips(withAlso(before, chip));
}

// ---- Brushes

/** Union of closed ranges of a number; the ends may be infinite. */
export type Ranges = [number, number][];

/** Returns the ranges of a brush chip, without its `not`; null if it has another form. */
export function rangesOf({ field, chain }: BrushChip): Ranges | null {
  if (WORD_FIELDS.has(field)) return null;
  const flat = flatten(chain);
  if (!flat) return null;
  const ranges: Ranges = [];
  for (const group of flat) {
    const range: [number, number] = [-Infinity, Infinity];
    for (const { op, value } of group) {
      const v = Number(value);
      if (op === '!=') return null;
      if (op !== '<' && op !== '<=') range[0] = Math.max(range[0], v);
      if (op !== '>' && op !== '>=') range[1] = Math.min(range[1], v);
    }
    if (range[0] <= range[1]) ranges.push(range);
  }
  return ranges.length ? ranges : null;
}

type Compare = Extract<Body, { kind: 'compare' }>;

/** Returns a chain as a union of intersections of comparisons; null if it has negations. */
function flatten(chain: Chain): Compare[][] | null {
  const out: Compare[][] = [];
  for (let i = 0; i < chain.terms.length; i++) {
    const { negated, body } = chain.terms[i]!;
    if (negated) return null;
    const isAnd = i > 0 && chain.joins[i - 1] === 'and';
    if (body.kind === 'compare') {
      if (isAnd) out.at(-1)!.push(body);
      else out.push([body]);
      continue;
    }
    // A group stands for itself within a union.
    if (body.kind !== 'group' || body.word !== null || isAnd || chain.joins[i] === 'and') return null;
    const inner = flatten(body.chain);
    if (!inner) return null;
    out.push(...inner);
  }
  return out;
}

/** Checks whether a name is `value` or lies in `value`. */
export const isWithin = (text: string, value: string): boolean =>
  text.startsWith(value) && (text.length === value.length || text[value.length] === '.' || text[value.length] === '/');

/**
 * Checks whether a category belongs to a brush chip of words, without its `not`.
 * - `text`: word or name of the category; null: none.
 */
export function hasCategory({ field, chain }: BrushChip, text: string | null): boolean {
  const isName = NAME_FIELDS.has(field);
  const compare = ({ op, value }: Compare) => {
    const isEqual = text !== null && (isName ? isWithin(text, value) : text === value);
    return op === '==' ? isEqual : !isEqual;
  };
  const holds = (chain: Chain): boolean => {
    let [any, all] = [false, true];
    chain.terms.forEach(({ negated, body }, i) => {
      if (i > 0 && chain.joins[i - 1] === 'or') [any, all] = [any || all, true];
      const is = body.kind === 'compare' ? compare(body) : body.kind === 'group' && holds(body.chain);
      all &&= is !== negated;
    });
    return any || all;
  };
  return holds(chain);
}

/** Rounds a bound outward to six significant digits, so that the range keeps what it contains. */
function bound(value: number, step: (v: number) => number): string {
  if (!Number.isFinite(value) || value === 0) return String(value);
  const power = 5 - Math.floor(Math.log10(Math.abs(value)));
  // A quotient of powers of ten is exact where their product is not.
  const scaled = power >= 0 ? value * 10 ** power : value / 10 ** -power;
  const whole = Math.abs(scaled - Math.round(scaled)) < 1e-6 ? Math.round(scaled) : step(scaled);
  return String(Number(`${whole}e${-power}`));
}

/** Formats ranges of a field; empty if one of them is of all numbers. `isWhole`: the values are whole numbers. */
export function formatRanges(field: string, ranges: Ranges, isWhole = false): string {
  if (ranges.some(([low, high]) => low === -Infinity && high === Infinity)) return '';
  return ranges
    .map(([low, high]) => {
      let [a, b] = [low, high];
      if (isWhole) {
        [a, b] = [Math.ceil(low - 1e-6), Math.floor(high + 1e-6)];
        if (a > b) a = b = Math.round((low + high) / 2);
      }
      const [from, to] = [bound(a, Math.floor), bound(b, Math.ceil)];
      const parts: string[] = [];
      if (from === to) return `${field} == ${from}`;
      if (a > -Infinity) parts.push(`${field} >= ${from}`);
      if (b < Infinity) parts.push(`${field} <= ${to}`);
      return parts.join(' and ');
    })
    .join(' or ');
}

/**
 * Formats a set of words or names of a field.
 * - `texts`: words; null is "none".
 * - `every`: all words that the field can have; "none" is what equals none of them.
 */
export function formatWords(field: string, texts: readonly (string | null)[], every: readonly string[]): string {
  return texts
    .map((text) => {
      if (text !== null) return `${field} == ${quote(text)}`;
      const roots = NAME_FIELDS.has(field) ? rootsOf(every) : every;
      const any = roots.map((it) => `${field} == ${quote(it)}`).join(' or ');
      return roots.length === 1 ? `not ${any}` : `not (${any})`;
    })
    .join(' or ');
}

/** Returns names that contain all others: `room` for `room.wall` and `room.floor`. */
export function rootsOf(names: readonly string[]): string[] {
  return [...new Set(names.map((name) => name.split(/[./]/, 1)[0] || name))];
}

/** Creates the chip of a text that compares one field. */
export function brushChip(text: string, negated: boolean): BrushChip {
  const chain = parse(text);
  const field = fieldOf(chain);
  if (field === null) throw new Error(`not a brush: ${text}`);
  return { kind: 'brush', negated, field, chain, text };
}

/** Quotes an argument of a shell command. */
export const shellQuote = (text: string): string =>
  /^[\w./:=+,-]+$/.test(text) ? text : `'${text.replaceAll("'", `'\\''`)}'`;

/**
 * Returns the command that lists the selected paths.
 * - `isBrightest`: of the brightest samples, not of the recorded paths
 */
export const command = (files: readonly string[], where: string, isBrightest = false): string =>
  [
    'femc paths',
    ...(files.length > 1 ? ['--union'] : []),
    ...files.map(shellQuote),
    ...(isBrightest ? ['--brightest'] : []),
    ...(where ? [`--where '${where.replaceAll("'", `'\\''`)}'`] : []),
  ].join(' ');

/** Returns a short text for a chip that would be long. */
export function shortText(chip: Chip): string {
  if (chip.kind === 'term') {
    if (chip.body.kind === 'lasso') return `in lasso of ${chip.body.numbers.length / 2} points`;
    return chip.text;
  }
  if (chip.kind === 'brush' && chip.text.length > 90) return `${chip.field}: ${chip.chain.terms.length} conditions`;
  return chip.kind === 'brush' ? chip.text : `${chip.word ?? ''}(${formatChips(chip.inner)})`;
}
