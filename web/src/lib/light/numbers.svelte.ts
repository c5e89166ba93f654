/** Requests for light in numbers. */

import { explain } from '../api';
import { light, type PictureComparison, type Source, type Summary } from './api';
import { whereIn, type Box } from './boxes';
import { Newest } from './state.svelte';

export interface NumbersWish {
  /** A, or A and B, with the tags of their data. */
  sets: readonly { source: Source; tag: string }[];
  where: string;
  /** Box A and box B. */
  boxes: readonly [Box | null, Box | null];
}

const PAUSE_MS = 150;

export class NumbersData {
  /** Numbers of A, or of A and B. */
  summaries = $state.raw<readonly Summary[] | null>(null);
  /** Numbers in box A and in box B. A data set without a box of its own uses the other one. */
  boxes = $state.raw<readonly Summary[]>([]);
  pictures = $state.raw<PictureComparison | null>(null);
  /** Whether the pictures were compared, or cannot be yet. */
  hasPictures = $state(false);
  pictureFault = $state.raw<string | null>(null);
  fault = $state.raw<string | null>(null);
  isBusy = $state(false);

  private key = '';
  private boxKey = '';
  private pictureKey = '';
  private readonly requests = new Newest(PAUSE_MS, (error) => {
    this.fault = explain(error);
    this.isBusy = false;
    this.key = '';
  });
  private readonly boxRequests = new Newest(PAUSE_MS, (error) => {
    this.fault = explain(error);
    this.boxKey = '';
  });
  private readonly comparisons = new Newest(1000, (error) => {
    this.pictureFault = explain(error);
    this.pictureKey = '';
  });

  load(wish: NumbersWish) {
    const { sets, where } = wish;
    const key = JSON.stringify([sets, where]);
    if (key !== this.key) {
      this.key = key;
      this.isBusy = true;
      this.requests.run(async (signal) => {
        const all = await Promise.all(sets.map((it) => light.summary(it.source, where, signal)));
        this.fault = null;
        this.isBusy = false;
        this.summaries = all.every((it) => it !== null) ? all : null;
      });
    }
    this.loadBoxes(wish);
    this.comparePictures(sets);
  }

  private loadBoxes({ sets, where, boxes: [a, b] }: NumbersWish) {
    const key = JSON.stringify([sets, where, a, b]);
    if (key === this.boxKey) return;
    this.boxKey = key;
    if (!a && !b) {
      this.boxRequests.clear();
      this.boxes = [];
      return;
    }
    const isPair = sets.length === 2 || (a && b);
    const wanted = [
      { set: sets[0]!, box: (a ?? b)! },
      ...(isPair ? [{ set: sets[1] ?? sets[0]!, box: (b ?? a)! }] : []),
    ];
    this.boxRequests.run(async (signal) => {
      const all = await Promise.all(wanted.map(({ set, box }) => light.summary(set.source, whereIn(where, box), signal)));
      this.fault = null;
      this.boxes = all.flatMap((it) => it ?? []);
    });
  }

  private comparePictures(sets: NumbersWish['sets']) {
    const [a, b] = sets;
    const key = JSON.stringify(sets);
    if (key === this.pictureKey) return;
    this.pictureKey = key;
    if (!a || !b) {
      this.comparisons.clear();
      this.pictures = null;
      return;
    }
    this.comparisons.run(async (signal) => {
      const answer = await light.compare(a.source, b.source, signal);
      this.pictureFault = null;
      this.pictures = answer;
      this.hasPictures = true;
    });
  }

  stop() {
    for (const it of [this.requests, this.boxRequests, this.comparisons]) it.stop();
  }
}
