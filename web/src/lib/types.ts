/**
 * Answers of the farm as JSON (docs/browser.md and the interface of the coordinator, version 1). Seconds are floats.
 * Absent values are null, or missing if the coordinator does not know the field.
 */

export type JobState = 'queued' | 'running' | 'paused' | 'done' | 'failed' | 'cancelled';
export type FrameState = 'waiting' | 'running' | 'done' | 'failed';
export type TaskState = FrameState | 'queued';
export type Role = 'viewer' | 'submitter' | 'operator' | 'admin';

/** A frame in progress; `frame` 0 stands for the job's own stages. */
export interface ActiveFrame {
  frame: number;
  stage: string;
  /** Number of the round, from 1. */
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
  /** Comment for people; empty: none. */
  comment: string;
  labels: Record<string, string>;
  /** URL to which a message is posted when the job has ended. */
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
  /** Relative error of the worst frame so far; null if no sample found light. */
  relative_error: number | null;
  /** Number of the worst frame. */
  worst_frame?: number | null;
  /** Target of each frame's relative error; null: the job stops by samples or by time. */
  error_target?: number | null;
  /** Reason why the error of the worst frame is above the target; null if it is not. */
  above_target?: 'rendering' | 'sample_limit' | 'estimate' | 'unknown' | null;
  /** Blocks of the worst frame, and those in which no sample found light. */
  blocks?: number | null;
  unlit_blocks?: number | null;
  /** Seconds from the first lease until now, or until the end. */
  seconds: number;
  /** Unix seconds, by the farm's clock. */
  submitted: number | null;
  submitted_date: number | null;
  workers: number;
  failure: string | null;
  active: ActiveFrame[];
  copies: number;
  quarantined: QuarantinedTask[];
  /** Reasons why its tasks wait, one sentence each. */
  /** Word for what all of its tasks wait for: `memory` or `store`. */
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

/** A former worker. */
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
  /** Null if the coordinator requires no login. */
  name: string | null;
  /** Null if the coordinator requires no login: everybody may do everything. */
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
  /** Tasks of each frame (or other scope) and round, before tasks are cut. */
  tasks?: number;
  rounds?: number;
}

export interface Spec {
  film: [number, number];
  tile: number;
  frames: number[];
  tags: string[];
  stages: StageTemplate[];
  /** File names of the clip and of the contact sheet, if the job makes them. */
  clip?: string | null;
  sheet?: string | null;
  /** Render settings, as JSON. */
  settings: string;
}

export interface Output {
  role: string;
  digest: string;
  bytes: number;
}

/** Times of the attempts that have ended; null: none has ended, or the times are unknown. */
export interface Times {
  /** Processor seconds of all attempts, summed. */
  processor_seconds?: number | null;
  /** Seconds that workers spent in attempts, summed. */
  wall_seconds?: number | null;
  /** Seconds without a running attempt, from the first lease to the end of the last one. */
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
  /** Null if no sample found light. */
  relative_error: number | null;
  /** Blocks of the frame, and those in which no sample found light. */
  blocks?: number | null;
  unlit_blocks?: number | null;
  /** Seconds from the first lease to the last result, waiting included. */
  seconds: number | null;
  /** Number of ended attempts at its tasks. */
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
  /** Number of the stage. */
  number: number;
  round: number;
  /** Workers that hold the task; for a done or failed task, workers that executed it. */
  workers: string[];
  /** Number of attempts that failed or are running; for a done task, of all attempts. */
  attempts: number;
  /** Seconds since the lease, while the task runs. */
  seconds: number | null;
  failure: string | null;
}

export interface TaskWindow {
  total: number;
  tasks: Task[];
}

/** A lease under which work began. Times are seconds by the farm's clock. */
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
