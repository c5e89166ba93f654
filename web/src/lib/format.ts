/** Formats numbers for people, with the words of the command line (cli/src/output/human.rs). */

/** `0.42 s`, `12.3 s`, `3 min 20 s`, `2 h 5 min`, `3 d 4 h`. */
export function seconds(s: number | null | undefined): string {
  if (s == null || !Number.isFinite(s) || s < 0) return '–';
  if (s < 10) return `${s.toFixed(2)} s`;
  if (s < 100) return `${s.toFixed(1)} s`;
  const whole = Math.round(s);
  if (whole < 3600) return `${Math.floor(whole / 60)} min ${whole % 60} s`;
  if (whole < 48 * 3600) return `${Math.floor(whole / 3600)} h ${Math.floor((whole % 3600) / 60)} min`;
  return `${Math.floor(whole / 86400)} d ${Math.floor((whole % 86400) / 3600)} h`;
}

/** Formats the time since a date in Unix seconds; `now` is in milliseconds. */
export const ago = (date: number | null, now: number): string =>
  date == null ? '–' : seconds(Math.max(0, Math.round(now / 1000 - date)));

/** Formats a date in Unix seconds in the browser's language; `undefined` if it is unknown. */
export const date = (unix: number | null): string | undefined =>
  unix == null ? undefined : new Date(1000 * unix).toLocaleString();

/** `999`, `12.3 k`, `4.56 M`, `7.89 G`: three significant digits. */
export function quantity(n: number | null | undefined): string {
  if (n == null || !Number.isFinite(n)) return '–';
  const size = Math.abs(n);
  const [scaled, unit] = size >= 1e9 ? [n / 1e9, ' G'] : size >= 1e6 ? [n / 1e6, ' M'] : [n / 1e3, ' k'];
  return size < 1e4 ? n.toFixed(0) : three(scaled) + unit;
}

/** `999 B`, `12.3 KiB`, `4.56 MiB`. */
export function bytes(n: number | null | undefined): string {
  if (n == null || !Number.isFinite(n)) return '–';
  if (n < 1024) return `${n.toFixed(0)} B`;
  const [scaled, unit] = n >= 2 ** 30 ? [n / 2 ** 30, 'GiB'] : n >= 2 ** 20 ? [n / 2 ** 20, 'MiB'] : [n / 1024, 'KiB'];
  return `${three(scaled)} ${unit}`;
}

/** Formats a fraction of one as `7.1 %`. */
export function percent(share: number | null | undefined): string {
  if (share == null || !Number.isFinite(share)) return '–';
  const value = 100 * share;
  const text =
    value >= 99.95 || value === 0 ? value.toFixed(0) : value >= 0.095 ? value.toFixed(1) : value.toPrecision(1);
  return `${text} %`;
}

/** Measurements of a frame. */
interface Measured {
  relative_error: number | null;
  blocks?: number | null;
  unlit_blocks?: number | null;
}

/** Formats the error of a frame briefly: `7.1 %`, or `unlit` if no sample found light. */
export function shortError({ relative_error, blocks, unlit_blocks }: Measured): string {
  if (blocks && unlit_blocks === blocks) return 'unlit';
  return percent(relative_error);
}

/** Formats the error of a frame: `7.1 %, 2 of 4 blocks met no light`. */
export function frameError(frame: Measured): string {
  const { blocks, unlit_blocks } = frame;
  if (!blocks || !unlit_blocks) return percent(frame.relative_error);
  if (unlit_blocks === blocks) return 'no sample met light';
  return `${percent(frame.relative_error)}, ${unlit_blocks} of ${blocks} blocks met no light`;
}

/** Measurements of a job: the error of its worst frame. */
interface MeasuredJob extends Measured {
  frames: number;
  worst_frame?: number | null;
  error_target?: number | null;
  above_target?: string | null;
}

/** Reasons why the error of a frame may be above the target. */
const ABOVE: Record<string, string> = {
  rendering: 'still rendering',
  sample_limit: 'the frame has reached the limit of samples',
  estimate: 'an estimate stopped the frame, and may miss the target slightly',
};

/** Formats the error of a job: `7.1 % in frame 3, above the target of 5.0 %: still rendering`. */
export function jobError(job: MeasuredJob): string {
  const place = job.worst_frame && job.frames > 1 ? ` in frame ${job.worst_frame}` : '';
  const measured = `${frameError(job)}${place}`;
  if (job.error_target == null || job.relative_error == null) return measured;
  const target = `the target of ${percent(job.error_target)}`;
  if (!job.above_target) return `${measured}, within ${target}`;
  const why = ABOVE[job.above_target];
  return `${measured}, above ${target}${why ? `: ${why}` : ''}`;
}

/** `1 job`, `2 jobs`. */
export function count(n: number, noun: string): string {
  return `${n.toLocaleString('en-US')} ${noun}${n === 1 ? '' : 's'}`;
}

/** Formats a physical value with about four digits: `0`, `0.01234`, `12.34`, `1.234e6`. */
export function value(x: number): string {
  if (Number.isNaN(x)) return 'not a number';
  if (!Number.isFinite(x)) return x > 0 ? '∞' : '-∞';
  const size = Math.abs(x);
  if (size === 0) return '0';
  if (size < 1e-3 || size >= 1e6) return x.toExponential(3);
  return x
    .toPrecision(4)
    .replace(/(\.\d*?)0+$/, '$1')
    .replace(/\.$/, '');
}

function three(n: number): string {
  const size = Math.abs(n);
  return n.toFixed(size < 10 ? 2 : size < 100 ? 1 : 0);
}

/** Formats frame numbers as ranges: `1..4, 7, 9..10`. */
export function ranges(numbers: Iterable<number>): string {
  const sorted = [...numbers].sort((a, b) => a - b);
  const parts: string[] = [];
  for (let i = 0; i < sorted.length;) {
    let j = i;
    while (j + 1 < sorted.length && sorted[j + 1] === sorted[j]! + 1) j++;
    parts.push(j > i + 1 ? `${sorted[i]}..${sorted[j]}` : sorted.slice(i, j + 1).join(', '));
    i = j + 1;
  }
  return parts.join(', ');
}
