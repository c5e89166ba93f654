/** Boxes that are compared, one for each data set; kept in the address. With one data set, both boxes are in it. */

export type Box = readonly [number, number, number, number, number, number];

/** Parses a box `x,y,z,x,y,z`: its lower corner, and then its upper one, m; null if there is none. */
export function parseBox(text: string | undefined): Box | null {
  const numbers = text?.split(',').map(Number) ?? [];
  const isBox = numbers.length === 6 && numbers.every(Number.isFinite) && [0, 1, 2].every((k) => numbers[k]! <= numbers[k + 3]!);
  return isBox ? (numbers as unknown as Box) : null;
}

export const parseBoxes = (a: string | undefined, b: string | undefined): [Box | null, Box | null] => [parseBox(a), parseBox(b)];

export const formatBoxText = (box: Box): string => box.join(',');

/** Returns the condition of a selection within a box. */
export const whereIn = (text: string, box: Box): string => {
  const inBox = `in box(${formatBoxText(box)})`;
  return text ? `(${text}) and ${inBox}` : inBox;
};
