/** Contract between the plot (ParallelPlot.svelte) and the page. */

export type TableName = 'paths' | 'intersections' | 'lights';
export type ScaleName = 'film' | 'world' | 'radiance' | 'throughput' | 'count' | 'class' | 'name';

/** An axis of a table, as the page describes it to the plot. */
export interface Axis {
  /** Number of the attribute in its table (index into `PlotSet.values`, `bins`). */
  index: number;
  /** Name, such as `radiance.r`. */
  name: string;
  scale: ScaleName;
  /** Lower edges of the 64 fine bins for `radiance` and `throughput` axes. */
  edges: readonly number[] | null;
  /** Range of `film` and `world` axes, in their unit: `[0, width]`, box. */
  extent: readonly [number, number] | null;
  /** Texts of the categories of `class` and `name` axes, in the order shown. Value k of a row is category k; 0 is "none", the last may be "others". */
  categories: readonly string[] | null;
}

/** View of an axis, kept in the address by the page. Order in the list is the order on the screen. */
export interface AxisView { index: number; hidden: boolean; log: boolean; flipped: boolean }

/** Brush on an axis: the union of its ranges (closed, in values of the axis) or, on categorical axes, a list of categories. */
export interface Brush { axis: number; ranges: [number, number][]; categories: number[]; inverted: boolean }

/** One data set in the plot: A, or A and B. Rows are representative records. */
export interface PlotSet {
  /** Columns by attribute index; one value per row (categorical axes: category number). */
  values: readonly Float32Array[];
  rows: number;
  /** 1 for rows in the selection; null: there is no selection. */
  selected: Uint8Array | null;
  /** Counts of the records in the 64 fine bins, by attribute index. */
  bins: readonly Float64Array[];
  /** Counts of the selected recorded records in the same bins; null: there is no selection. */
  selectedBins: readonly Float64Array[] | null;
  /** Joint counts, 64 x 64, row: bin of attribute `a`, column: bin of attribute `b`; null until they are loaded. */
  pair(a: number, b: number): Float32Array | null;
  /** Number of records behind `bins`. */
  total: number;
  /** Number of recorded records, which `selectedBins` and `pair` are counts of. */
  selectedTotal: number;
  /** Records behind `bins`. */
  basis: 'all samples' | 'recorded';
}

/** Props of ParallelPlot.svelte */
export interface PlotProps {
  table: TableName;
  title: string;
  axes: readonly Axis[];
  views: readonly AxisView[];
  sets: readonly PlotSet[]; // 1 or 2
  brushes: readonly Brush[];
  /** Reason why brushes cannot be changed; null if they can. */
  lock?: string | null;
  /** Opacity of a line, 0 to 1. */
  opacity: number;
  showDensity: boolean;
  height?: number;
  onviews: (views: AxisView[]) => void;
  onbrushes: (brushes: Brush[], isFinal: boolean) => void; // isFinal=false while dragging
  /** Pairs of neighboring attributes on the screen, whenever they change, so that the page loads their joint histograms. */
  onpairs: (pairs: [number, number][]) => void;
  /** Milliseconds from a change until all lines are on the screen. */
  ondrawn?: (milliseconds: number) => void;
}
