/** The eye of the scene view: a place that turns about a target. Kept in the address. */

import type { SceneCamera, Vec3 } from './glb';

export interface Eye {
  /** Point in the middle of the view, in coordinates of the scene, m. */
  target: Vec3;
  /** Angle about the z axis, radians; 0: the eye is on the x side of the target. */
  yaw: number;
  /** Height of the eye over the target as an angle, radians. */
  pitch: number;
  /** Distance to the target, m. */
  distance: number;
  /** Vertical angle of view, radians. */
  fov: number;
}

/** Greatest pitch: straight up and down have no horizon. */
const MOST_PITCH = 1.5533;
const DEFAULT_FOV = 0.7;

const clamp = (value: number, low: number, high: number) => Math.min(Math.max(value, low), high);

/** Returns the unit vector from the target to the eye. */
export function outward({ yaw, pitch }: Pick<Eye, 'yaw' | 'pitch'>): Vec3 {
  const c = Math.cos(pitch);
  return [c * Math.cos(yaw), c * Math.sin(yaw), Math.sin(pitch)];
}

/** Returns the position of the eye. */
export function placeOf(eye: Eye): Vec3 {
  const d = outward(eye);
  return [0, 1, 2].map((i) => eye.target[i]! + eye.distance * d[i]!) as unknown as Vec3;
}

/** Returns the directions to the right and up on the screen. */
export function sides({ yaw, pitch }: Eye): { right: Vec3; up: Vec3 } {
  const [c, s] = [Math.cos(yaw), Math.sin(yaw)];
  return { right: [-s, c, 0], up: [-Math.sin(pitch) * c, -Math.sin(pitch) * s, Math.cos(pitch)] };
}

/** Turns the eye about the target. */
export function turned(eye: Eye, yaw: number, pitch: number): Eye {
  const next = (eye.yaw + yaw) % (2 * Math.PI);
  return { ...eye, yaw: next, pitch: clamp(eye.pitch + pitch, -MOST_PITCH, MOST_PITCH) };
}

/** Moves eye and target along the screen, in heights of the view. */
export function moved(eye: Eye, x: number, y: number): Eye {
  const { right, up } = sides(eye);
  const height = 2 * eye.distance * Math.tan(eye.fov / 2);
  const target = [0, 1, 2].map((i) => eye.target[i]! + height * (x * right[i]! + y * up[i]!)) as unknown as Vec3;
  return { ...eye, target };
}

/** Brings the eye nearer to the target: `factor` times the distance. */
export const nearer = (eye: Eye, factor: number): Eye => ({
  ...eye,
  distance: clamp(eye.distance * factor, 1e-4, 1e7),
});

/**
 * Returns an eye that sees a whole box.
 * - `aspect`: width by height of the view.
 */
export function around(low: Vec3, high: Vec3, aspect: number): Eye {
  const target = [0, 1, 2].map((i) => (low[i]! + high[i]!) / 2) as unknown as Vec3;
  const radius = Math.hypot(...[0, 1, 2].map((i) => high[i]! - low[i]!)) / 2 || 1;
  const narrower = Math.atan(Math.tan(DEFAULT_FOV / 2) * Math.min(aspect, 1));
  return { target, yaw: -1.1, pitch: 0.45, distance: radius / Math.sin(narrower), fov: DEFAULT_FOV };
}

/**
 * Returns the eye of a camera of the scene. A roll of the camera is not kept.
 * - `radius`: half the extent of the scene. The target lies at most so far before the camera.
 * - `aspect`: width by height of the view; a narrow one gets a wider angle, so that it contains the whole film.
 */
export function eyeOf(camera: SceneCamera, origin: Vec3, radius: number, aspect: number): Eye {
  const { matrix: m } = camera;
  const back = unit([m[8]!, m[9]!, m[10]!]);
  const at: Vec3 = [m[12]! + origin[0], m[13]! + origin[1], m[14]! + origin[2]];
  const distance = radius;
  const fov = aspect < camera.aspect ? 2 * Math.atan((Math.tan(camera.fov / 2) * camera.aspect) / aspect) : camera.fov;
  return {
    target: [0, 1, 2].map((i) => at[i]! - distance * back[i]!) as unknown as Vec3,
    yaw: Math.hypot(back[0], back[1]) < 1e-9 ? Math.atan2(-m[5]!, -m[4]!) : Math.atan2(back[1], back[0]),
    pitch: clamp(Math.asin(clamp(back[2], -1, 1)), -MOST_PITCH, MOST_PITCH),
    distance,
    fov,
  };
}

function unit(v: Vec3): Vec3 {
  const length = Math.hypot(...v) || 1;
  return [v[0] / length, v[1] / length, v[2] / length];
}

/** Rounds to what is visible. */
const short = (value: number, step: number) => String(Number((Math.round(value / step) * step).toPrecision(7)));

/** Formats an eye for the address. */
export function formatEye({ target, yaw, pitch, distance, fov }: Eye): string {
  // A ten-thousandth of the distance is less than a pixel.
  const step = 10 ** Math.floor(Math.log10(distance) - 4);
  return [
    ...[...target, distance].map((v) => short(v, step)),
    ...[yaw, pitch, fov].map((v) => short(v, 1e-4)),
  ].join(',');
}

/** Parses an eye from the address; null if there is none. */
export function parseEye(text: string | undefined): Eye | null {
  const [x, y, z, distance, yaw, pitch, fov, ...rest] = (text || 'none').split(',').map(Number);
  const all = [x, y, z, distance, yaw, pitch, fov];
  if (rest.length || all.some((v) => v === undefined || !Number.isFinite(v))) return null;
  if (!(distance! > 0) || !(fov! > 0.01 && fov! < 3.1)) return null;
  return { target: [x!, y!, z!], distance: distance!, yaw: yaw!, pitch: clamp(pitch!, -MOST_PITCH, MOST_PITCH), fov: fov! };
}

/** Parses bookmarks: eyes with `;` between them. */
export const parseEyes = (text: string | undefined): Eye[] =>
  (text ?? '')
    .split(';')
    .map(parseEye)
    .filter((it): it is Eye => it !== null)
    .slice(0, 9);

export const formatEyes = (eyes: readonly Eye[]): string => eyes.map(formatEye).join(';');

/** A plane that cuts the scene open, across an axis. */
export interface Cut {
  axis: 0 | 1 | 2;
  /** Position along the axis, m. */
  at: number;
  /** Whether the part above the position is hidden, instead of the part below. */
  hidesAbove: boolean;
}

export const formatCut = ({ axis, at, hidesAbove }: Cut): string => `${'xyz'[axis]}${hidesAbove ? '<' : '>'}${Number(at.toPrecision(5))}`;

export function parseCut(text: string | undefined): Cut | null {
  const found = /^([xyz])([<>])(-?\d+(?:\.\d+)?(?:e-?\d+)?)$/.exec(text ?? '');
  if (!found) return null;
  return { axis: 'xyz'.indexOf(found[1]!) as 0 | 1 | 2, at: Number(found[3]), hidesAbove: found[2] === '<' };
}

/** Checks whether a point is visible with a cut. */
export const isKept = (cut: Cut | null, point: Vec3): boolean =>
  cut === null || (cut.hidesAbove ? point[cut.axis] <= cut.at : point[cut.axis] >= cut.at);
