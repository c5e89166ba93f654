/** How a picture is shown, and the pixels that it is made of. */

import { api, type PixelSource } from './api';
import { isMapped, luminances, MEASURES, SHOWS, type Measured, type Show } from './picture';
import type { Pixels } from './pixels';
import { Resource, views } from './stores.svelte';

const within = (text: string | undefined, low: number, high: number) => Math.min(Math.max(Number(text) || 0, low), high);

/** Settings of the picture; kept in the URL. */
class PictureView {
  show = $derived<Show>(SHOWS.find((it) => it === views.query.show) ?? 'picture');
  /** Exposure relative to the automatic one, EV. */
  stops = $derived(within(views.query.ev, -12, 12));
  /** Standard deviation of the Gaussian that smooths, pixels. */
  sigma = $derived(within(views.query.smooth, 0, 16));
}

export const pictureView = new PictureView();

/** Requests pixels, again and again as they grow. */
function follow(source: PixelSource) {
  let etag: string | null = null;
  return new Resource<{ pixels: Pixels | null }>(async (signal) => {
    const answer = await api.pixels(source, etag, signal);
    if (answer) etag = answer.etag;
    return answer;
  }, 1500);
}

/** Pixels of a frame of a job, or of a statistics file, which has no image but maps. */
export class FramePixels {
  private readonly image: Resource<{ pixels: Pixels | null }>;
  private readonly statistics: Resource<{ pixels: Pixels | null }>;

  constructor(readonly source: { job: number; frame: number } | { file: number }) {
    const isFile = 'file' in source;
    this.image = follow(isFile ? source : { ...source, what: 'pixels' });
    this.statistics = isFile ? this.image : follow({ ...source, what: 'maps' });
  }

  /** The image and its errors; null until there are some. */
  get pixels(): Pixels | null {
    return this.image.value?.pixels ?? null;
  }
  /** Maps of the light statistics; null if there are none. */
  get maps(): Pixels | null {
    return this.statistics.value?.pixels ?? null;
  }
  /** Whether the coordinator has answered what this picture needs. */
  hasAnswer(show: Show): boolean {
    return (isMapped(show) ? this.statistics : this.image).value !== null;
  }
  error(show: Show): string | null {
    return this.image.error ?? (isMapped(show) ? this.statistics.error : null);
  }
  /** Returns the values of a map; null if the frame does not have it. */
  values(show: Measured): Float32Array | null {
    const pixels = isMapped(show) ? this.maps : this.pixels;
    return pixels && (show === 'luminance' ? luminances(pixels) : pixels.floats(MEASURES[show].channel));
  }

  /** Asks for new pixels; for maps of the light statistics only if they are shown. */
  refresh(show: Show) {
    this.image.refresh();
    if (isMapped(show) && this.statistics !== this.image) this.statistics.refresh();
  }
  stop() {
    this.image.stop();
    this.statistics.stop();
  }
}
