/** Selection of pixels by a closed line around them. */

export interface Point {
  x: number;
  y: number;
}

const MOST_POINTS = 48;

/** Parses points such as `10,20;30,20;30,40`. Fewer than three points give an empty list. */
export function parseLasso(text: string | undefined): Point[] {
  const points: Point[] = [];
  for (const part of (text ?? '').split(';').slice(0, 4 * MOST_POINTS)) {
    const match = /^(\d{1,6}),(\d{1,6})$/.exec(part);
    if (match) points.push({ x: Number(match[1]), y: Number(match[2]) });
  }
  return points.length >= 3 ? points : [];
}

export const formatLasso = (points: readonly Point[]): string => points.map(({ x, y }) => `${x},${y}`).join(';');

/** Simplifies the line to at most `most` points with as little deviation as possible (Douglas and Peucker, 1973). */
export function simplify(points: readonly Point[], most = MOST_POINTS): Point[] {
  let kept = [...points];
  for (let tolerance = 0.75; kept.length > most; tolerance *= 1.6) kept = reduce(points, tolerance);
  return kept;
}

function reduce(points: readonly Point[], tolerance: number): Point[] {
  const [a, b] = [points[0], points.at(-1)];
  if (!a || !b || points.length < 3) return [...points];
  let [furthest, at] = [0, 0];
  const length = Math.hypot(b.x - a.x, b.y - a.y);
  for (let i = 1; i < points.length - 1; i++) {
    const p = points[i]!;
    const distance =
      length > 0
        ? Math.abs((b.x - a.x) * (a.y - p.y) - (a.x - p.x) * (b.y - a.y)) / length
        : Math.hypot(p.x - a.x, p.y - a.y);
    if (distance > furthest) [furthest, at] = [distance, i];
  }
  if (furthest <= tolerance) return [a, b];
  return [...reduce(points.slice(0, at + 1), tolerance).slice(0, -1), ...reduce(points.slice(at), tolerance)];
}

/** Returns the indices, row by row, of the pixels whose centers lie within the line (even-odd rule). */
export function inside(points: readonly Point[], width: number, height: number): Uint32Array {
  const chosen: number[] = [];
  const low = Math.max(0, Math.floor(Math.min(...points.map((p) => p.y))));
  const high = Math.min(height - 1, Math.ceil(Math.max(...points.map((p) => p.y))));
  for (let y = low; y <= high; y++) {
    const crossings: number[] = [];
    points.forEach((a, i) => {
      const b = points[(i + 1) % points.length]!;
      if (a.y <= y + 0.5 !== b.y <= y + 0.5) crossings.push(a.x + ((y + 0.5 - a.y) / (b.y - a.y)) * (b.x - a.x));
    });
    crossings.sort((a, b) => a - b);
    for (let i = 0; i + 1 < crossings.length; i += 2) {
      const [from, to] = [
        Math.max(0, Math.ceil(crossings[i]! - 0.5)),
        Math.min(width, Math.ceil(crossings[i + 1]! - 0.5)),
      ];
      for (let x = from; x < to; x++) chosen.push(y * width + x);
    }
  }
  return Uint32Array.from(chosen);
}
