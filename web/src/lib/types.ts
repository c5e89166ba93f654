/**
 * What the farm says, as JSON (docs/browser.md and the interface of the coordinator, version 1). Seconds are floats;
 * what is absent
 * is null, or missing from a coordinator that does not know of it.
 */

export type JobState = 'queued' | 'running' | 'paused' | 'done' | 'failed' | 'cancelled';
export type FrameState = 'waiting' | 'running' | 'done' | 'failed';
export type TaskState = FrameState | 'queued';
export type Role = 'viewer' | 'submitter' | 'operator' | 'admin';

/** A frame in work; `frame` 0 stands for the job's own stages. */
export interface ActiveFrame {
  frame: number;
  stage: string;
  /** From 1. */
  round: number;
  rounds: number;
  tiles_done: number;
  tiles: number;
  running: number;
  samples: number;
  relative_error: number | null;
  blocks?: number | null;
  unlit_blocks?: number | null;
}

/** A task that used up its attempts. */
export interface QuarantinedTask {
  task: string;
  frame: number;
  attempts: number;
  failure: string;
}

export interface Job {
  job: number;
  name: string;
  state: JobState;
  owner: string;
  /** Path of the scene file. */
  scene: string;
  /** A line for people; empty: none. */
  comment: string;
  labels: Record<string, string>;
  /** URL to which a message is posted at its end. */
  notify: string | null;
  /** 0..100; greater goes first. */
  priority: number;
  frames: number;
  frames_done: number;
  frames_failed: number;
  samples: number;
  samples_most: number;
  samples_per_second: number;
  bad_samples: number;
  /** Of the worst frame so far; null where no sample met light. */
  relative_error: number | null;
  /** Number of that frame. */
  worst_frame?: number | null;
  /** Relative error that each frame is to reach; null: the job stops by samples or by time. */
  error_target?: number | null;
  /** Why the error of the worst frame is above the target; null where it is not. */
  above_target?: 'rendering' | 'sample_limit' | 'estimate' | 'unknown' | null;
  /** Blocks of that frame, and those in which no sample met light. */
  blocks?: number | null;
  unlit_blocks?: number | null;
  /** Since the first lease, or from the first lease to the end. */
  seconds: number;
  /** Unix seconds, by the farm's clock. */
  submitted: number | null;
  submitted_date: number | null;
  workers: number;
  failure: string | null;
  active: ActiveFrame[];
  copies: number;
  quarantined: QuarantinedTask[];
  /** Why tasks of it wait, a sentence each. */
  /** What all of its tasks wait for, in a word: `memory` or `store`. */
  waits_for?: string | null;
  waits: string[];
}

export interface Worker {
  worker: number;
  name: string;
  threads: number;
  tags: string[];
  tasks: string[];
  silent_seconds: number;
  completed: number;
  failed: number;
  intake: 'open' | 'off' | 'draining';
  engine: string;
}

/** A worker that was there. */
export interface OfflineWorker {
  name: string;
  threads: number;
  tags: string[];
  engine: string;
  intake: 'offline';
  /** Unix seconds. */
  last_contact: number;
}

export interface Me {
  /** Null where nobody is asked. */
  name: string | null;
  /** Null on a coordinator that asks nobody who they are: everybody may do everything. */
  role: Role | null;
  secured: boolean;
  version: string;
  engine: string;
  /** Seconds since 1970 by the coordinator's clock. */
  farm_time: number;
}

export interface StageTemplate {
  number: number;
  kind: string;
  scope: string;
  needs: number[];
  /** Of each frame (or other scope) and round, before tasks are cut. */
  tasks?: number;
  rounds?: number;
}

export interface Spec {
  film: [number, number];
  tile: number;
  frames: number[];
  tags: string[];
  stages: StageTemplate[];
  /** Names of the files of the clip and of the contact sheet, where the job makes these. */
  clip?: string | null;
  sheet?: string | null;
  /** Settings of the render, as JSON. */
  settings: string;
}

export interface Output {
  role: string;
  digest: string;
  bytes: number;
}

/** Times of attempts that have ended; null: none has, or they are not known. */
export interface Times {
  /** Of all attempts, summed. */
  processor_seconds?: number | null;
  /** That workers spent in attempts, summed. */
  wall_seconds?: number | null;
  /** From the first lease to the end of the last one, while no attempt ran. */
  waiting_seconds?: number | null;
}

export interface Frame extends Times {
  frame: number;
  state: FrameState;
  stage: string | null;
  tiles_done: number;
  tiles: number;
  running: number;
  samples: number;
  /** Null where no sample met light. */
  relative_error: number | null;
  /** Blocks of it, and those in which no sample met light. */
  blocks?: number | null;
  unlit_blocks?: number | null;
  /** From the first lease to the last result, waiting included. */
  seconds: number | null;
  /** Attempts at its tasks that have ended. */
  attempts?: number;
  has_image: boolean;
  outputs: Output[];
}

export interface Task extends Times {
  task: string;
  frame: number;
  stage: string;
  index: number;
  state: TaskState;
  /** Of the stage. */
  number: number;
  round: number;
  /** Who has it now; of a task that is done or failed, who did it or tried. */
  workers: string[];
  /** Those that failed, or run now; of a task that is done, all. */
  attempts: number;
  /** Since the lease, while it runs. */
  seconds: number | null;
  failure: string | null;
}

export interface TaskWindow {
  total: number;
  tasks: Task[];
}

/** One lease that was begun; times are seconds by the farm's clock. */
export interface Attempt {
  job: number;
  task: string;
  frame: number;
  stage: string;
  attempt: number;
  epoch: number;
  worker: string;
  ending: string | null;
  began_seconds: number;
  ended_seconds: number;
  wait_seconds: number | null;
  wall_seconds: number | null;
  cpu_seconds: number | null;
  peak_memory_bytes: number | null;
  samples: number | null;
  rays: number | null;
}

export interface LogRecord {
  task: string;
  epoch: number;
  worker: string;
  attempt: 'done' | 'failed';
  seconds: number;
  text: string;
}

export interface Refused {
  job?: number;
  worker?: number | string;
  code: string;
  message: string;
}

export interface Done<T> {
  done: T[];
  refused: Refused[];
}

export type JobAction = 'pause' | 'resume' | 'cancel' | 'retry' | 'priority' | 'delete';

export interface AuditLine {
  time?: string;
  who?: string;
  by?: string;
  from?: string;
  call?: string;
  job?: number;
  what?: string;
  outcome?: string;
  why?: string;
  times?: number;
}
