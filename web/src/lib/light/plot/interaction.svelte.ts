/** Changes of a plot by pointer and keys: brushes on the axes, and the order of the axes. */

import { isEmpty, toggled, withBrush } from './brush';
import type { Column } from './column';
import type { AxisView, Brush } from './contract';
import { beginDrag, brushAfterKey, draggedBrush, type BrushDrag } from './drag';
import { placeAt, xOf, type Layout } from './layout';
import { changed, moved, shownViews } from './order';

/** Plot that is changed, and the page's functions for changes. */
export interface InteractionTarget {
  views(): readonly AxisView[];
  brushes(): readonly Brush[];
  /** Reason why brushes cannot be changed; null if they can. */
  lock(): string | null;
  columns(): readonly Column[];
  layout(): Layout;
  /** Element that the layout is the place of. */
  field(): HTMLElement;
  onviews(views: AxisView[]): void;
  onbrushes(brushes: Brush[], isFinal: boolean): void;
  /** Called when a brush begins to be dragged. */
  ongrab(): void;
  /** Called when a finger touches an axis and does not move. */
  ontap(x: number, y: number): void;
}

/** Title of an axis that is dragged to another place. */
export interface TitleDrag {
  index: number;
  /** Distance of the pointer from the axis where the drag began, and from the place of the axis now. */
  x: number;
  dx: number;
  hasMoved: boolean;
}

/** Distance after which a press is a drag, in pixels. */
const MIN_BRUSH_DRAG = 3;
const MIN_TITLE_DRAG = 5;
/** Distance from the end of a range within which the pointer holds it, in pixels; fingers need more. */
const POINTER_REACH = 10;
const FINGER_REACH = 22;

export class Interaction {
  /** Brushes and views while they are dragged. */
  private draft = $state.raw<Brush[] | null>(null);
  private draftViews = $state.raw<AxisView[] | null>(null);
  titleDrag = $state.raw<TitleDrag | null>(null);

  readonly brushes = $derived.by((): readonly Brush[] => this.draft ?? this.target.brushes());
  readonly views = $derived.by((): readonly AxisView[] => this.draftViews ?? this.target.views());

  private drag: BrushDrag | null = null;
  private before: readonly Brush[] = [];
  private y = 0;
  private frame = 0;
  private skipsClick = false;

  constructor(
    private readonly target: InteractionTarget,
    private readonly isCoarse: () => boolean,
  ) {}

  /** Checks whether something is dragged. */
  get isDragging(): boolean {
    return this.drag !== null || this.titleDrag !== null;
  }

  /** Returns whether the click that follows the drag of a title is to be ignored. */
  skipClick(): boolean {
    const skips = this.skipsClick;
    this.skipsClick = false;
    return skips;
  }

  destroy() {
    cancelAnimationFrame(this.frame);
  }

  // Brushes -----------------------------------------------------------------------------------------------------------

  /** Sets a brush for good. */
  finish(brush: Brush) {
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    const all = withBrush(this.brushes, brush);
    if (!this.target.lock()) this.target.onbrushes(all, true);
    this.draft = null;
  }

  clear(column: Column) {
    this.finish({ ...column.brush, ranges: [], categories: [], inverted: false });
  }

  invert({ brush }: Column) {
    if (!isEmpty(brush)) this.finish({ ...brush, inverted: !brush.inverted });
  }

  down(event: PointerEvent, column: Column) {
    const { target } = this;
    if (event.button !== 0 || this.drag || target.lock()) return;
    this.before = target.brushes();
    this.y = this.yIn(event);
    this.drag = beginDrag(column, target.layout(), this.y, this.isCoarse() ? FINGER_REACH : POINTER_REACH);
    (event.currentTarget as HTMLElement).setPointerCapture(event.pointerId);
    target.ongrab();
  }

  /** Follows the pointer, at most once a frame. */
  move(event: PointerEvent) {
    const { drag } = this;
    if (!drag) return;
    this.y = this.yIn(event);
    if (Math.abs(this.y - drag.y) > MIN_BRUSH_DRAG) drag.hasMoved = true;
    if (drag.hasMoved) this.frame ||= requestAnimationFrame(this.follow);
  }

  private readonly follow = () => {
    const { drag, target } = this;
    this.frame = 0;
    if (!drag || target.lock()) return;
    this.draft = withBrush(this.brushes, draggedBrush(drag, target.layout(), this.y));
    target.onbrushes(this.draft, false);
  };

  up(event: PointerEvent) {
    const { drag, target } = this;
    if (!drag) return;
    const { column, hasMoved } = drag;
    if (hasMoved) this.finish(draggedBrush(drag, target.layout(), this.yIn(event)));
    else if (column.scale.isCategorical) this.finish(toggled(column.brush, column.scale.value(drag.from)));
    this.drag = null;
    if (!hasMoved && event.pointerType === 'touch') target.ontap(column.x, this.yIn(event));
  }

  cancel() {
    cancelAnimationFrame(this.frame);
    this.frame = 0;
    if (this.drag?.hasMoved) this.target.onbrushes([...this.before], true);
    this.drag = null;
    this.draft = null;
  }

  /** Handles a key on the lower (0) or upper (1) end of a range. */
  keyOnEnd(event: KeyboardEvent, column: Column, number: number, end: 0 | 1) {
    if (event.altKey || this.target.lock()) return;
    const brush = brushAfterKey(column, number, end, event.key);
    if (!brush) return;
    event.preventDefault();
    this.finish(brush);
  }

  private yIn = (event: PointerEvent) => event.clientY - this.target.field().getBoundingClientRect().top;
  private xIn = (event: PointerEvent) => event.clientX - this.target.field().getBoundingClientRect().left;

  // Axes --------------------------------------------------------------------------------------------------------------

  /** Changes settings of an axis. */
  set(index: number, to: Partial<AxisView>) {
    this.target.onviews(changed(this.target.views(), index, to));
  }

  /** Moves an axis by a number of places. */
  shift(index: number, by: number) {
    const at = this.target.columns().findIndex((it) => it.index === index);
    this.target.onviews(moved(this.target.views(), index, at + by));
  }

  titleDown(event: PointerEvent, column: Column) {
    if (event.button !== 0) return;
    this.titleDrag = { index: column.index, x: this.xIn(event) - column.x, dx: 0, hasMoved: false };
    (event.currentTarget as HTMLElement).setPointerCapture(event.pointerId);
  }

  titleMove(event: PointerEvent) {
    const { titleDrag, target } = this;
    const column = target.columns().find((it) => it.index === titleDrag?.index);
    if (!titleDrag || !column) return;
    const x = this.xIn(event) - titleDrag.x;
    const hasMoved = titleDrag.hasMoved || Math.abs(x - column.x) > MIN_TITLE_DRAG;
    if (!hasMoved) return;
    const layout = target.layout();
    const to = Math.min(Math.max(placeAt(layout, x), 0), shownViews(this.views).length - 1);
    if (xOf(layout, to) !== column.x) this.draftViews = moved(this.views, titleDrag.index, to);
    this.titleDrag = { ...titleDrag, hasMoved, dx: x - xOf(layout, to) };
  }

  titleUp() {
    this.skipsClick = this.titleDrag?.hasMoved ?? false;
    this.titleDrag = null;
    if (this.draftViews) this.target.onviews(this.draftViews);
    this.draftViews = null;
  }

  titleCancel() {
    this.titleDrag = null;
    this.draftViews = null;
  }
}
