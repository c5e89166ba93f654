/** Order of a table: a column and a direction. The URL has it as `name` or `-name`. */

export interface Order {
  key: string;
  descending: boolean;
}

/** Parses an order from the URL; null for a key that is not in `keys`. */
export function parseOrder(text: string | null | undefined, keys: readonly string[]): Order | null {
  const key = (text ?? '').replace(/^-/, '');
  return text && keys.includes(key) ? { key, descending: text.startsWith('-') } : null;
}

/**
 * Returns the next order when the user clicks a column. First click: numbers descending, words ascending. Second
 * click: reversed. Third click: no order.
 */
export function nextOrder(order: Order | null, key: string, number: boolean): string | null {
  if (order?.key !== key) return number ? `-${key}` : key;
  if (order.descending !== number) return null;
  return number ? key : `-${key}`;
}

/** Returns the `aria-sort` value of a column. */
export const direction = (order: Order | null, key: string): 'ascending' | 'descending' | 'none' =>
  order?.key !== key ? 'none' : order.descending ? 'descending' : 'ascending';

type Value = number | string | null | undefined;

/** Sorts by a value. Items without a value come last in either direction; equal ones keep their order. */
export function sortedBy<T>(all: readonly T[], of: (one: T) => Value, descending: boolean): T[] {
  const sign = descending ? -1 : 1;
  return all.toSorted((a, b) => {
    const [x, y] = [of(a), of(b)];
    if (x == null || y == null) return x == null ? (y == null ? 0 : 1) : -1;
    if (typeof x === 'string' || typeof y === 'string') return sign * String(x).localeCompare(String(y));
    return sign * (x - y);
  });
}
