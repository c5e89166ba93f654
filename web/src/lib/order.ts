/** The order of a table: a column, and which end comes first. It stands in the address as `name` or `-name`. */

export interface Order {
  key: string;
  descending: boolean;
}

/** A text of the address as an order; a key that is none of these is no order. */
export function parseOrder(text: string | null | undefined, keys: readonly string[]): Order | null {
  const key = (text ?? '').replace(/^-/, '');
  return text && keys.includes(key) ? { key, descending: text.startsWith('-') } : null;
}

/**
 * The next order when somebody chooses a column: numbers begin with the greatest, words with the first; the second time it is turned
 * round, and the third time there is none.
 */
export function nextOrder(order: Order | null, key: string, number: boolean): string | null {
  if (order?.key !== key) return number ? `-${key}` : key;
  if (order.descending !== number) return null;
  return number ? key : `-${key}`;
}

/** What `aria-sort` says of a column. */
export const direction = (order: Order | null, key: string): 'ascending' | 'descending' | 'none' =>
  order?.key !== key ? 'none' : order.descending ? 'descending' : 'ascending';

type Value = number | string | null | undefined;

/** Sorted by a value; those without one come last in either direction, equal ones stay in their order. */
export function sortedBy<T>(all: readonly T[], of: (one: T) => Value, descending: boolean): T[] {
  const sign = descending ? -1 : 1;
  return all.toSorted((a, b) => {
    const [x, y] = [of(a), of(b)];
    if (x == null || y == null) return x == null ? (y == null ? 0 : 1) : -1;
    if (typeof x === 'string' || typeof y === 'string') return sign * String(x).localeCompare(String(y));
    return sign * (x - y);
  });
}
