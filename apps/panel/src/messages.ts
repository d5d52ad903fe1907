// What comes on the channels. Foxglove's own schemas, and those of this program (apps/panel_feed.c).

export interface Vector {
  x: number;
  y: number;
  z: number;
}
export interface Quaternion extends Vector {
  w: number;
}
export interface Pose {
  position: Vector;
  orientation: Quaternion;
}
export interface Transforms {
  transforms: { parent_frame_id: string; child_frame_id: string; translation: Vector; rotation: Quaternion }[];
}
export interface PoseInFrame {
  frame_id: string;
  pose: Pose;
}
export interface Colour {
  r: number;
  g: number;
  b: number;
  a: number;
}
interface Solid {
  pose: Pose;
  size: Vector;
  color: Colour;
}
export interface SceneUpdate {
  deletions?: { type: number; id: string }[];
  entities: {
    frame_id: string;
    id: string;
    cubes: Solid[];
    spheres: Solid[];
    cylinders: (Solid & { bottom_scale: number; top_scale: number })[];
    lines?: { type: number; pose: Pose; thickness: number; color: Colour; colors?: Colour[]; points: Vector[]; indices?: number[] }[];
    texts?: { pose: Pose; text: string }[];
    metadata?: { key: string; value: string }[];
  }[];
}
export interface Grid {
  frame_id: string;
  pose: Pose;
  column_count: number;
  cell_size: { x: number; y: number };
  row_stride: number;
  cell_stride: number;
  fields: { name: string; offset: number; type: number }[];
  data: string;
}
export interface Log {
  timestamp: { sec: number; nsec: number };
  level: number;
  message: string;
  name: string;
}
export interface JointStates {
  timestamp: { sec: number; nsec: number };
  joints: { name: string; position: number; rate: number; force: number }[];
}
export interface Session {
  phase: string;
  step: number;
  steps: number;
  motion: number;
  share: number;
  load_kg: number;
  contact_n: number;
  press_n: number | null;
  offers: string[];
  operator: number;
}
export interface Diagnostics {
  ticks: number;
  misses: number;
  late_p99_s: number;
  late_max_s: number;
  real_time_factor: number;
  clients: number;
  operator: number;
  samples_dropped: number;
  orders: number;
  refused: number;
}
/** A machine elsewhere, as the panel hears it. */
export interface Far {
  open: boolean;
  why: string;
  mode: string;
  phase: string;
  fault: string;
  round_trip_mean_s: number;
  lost_share: number;
  state_age_s: number | null;
  image_age_s: number | null;
}
export interface Behaviour {
  phases: { name: string; text: string }[];
  events: { name: string; text: string; order: boolean }[];
  ways: { from: string; event: string; to: string }[]; // event "": by itself, when the checks have passed
  faults: string[];
}
export interface ParameterAbout {
  name: string;
  settable: boolean;
  low?: number;
  high?: number;
  choices?: string[];
}
export interface Panel {
  scenario: string;
  robot: string;
  task: string;
  about: string;
  task_frame: 'site' | 'vehicle';
  period_s: number;
  ground: boolean;
  joints: { name: string; unit: 'rad' | 'm'; low: number | null; high: number | null }[];
  parameters: ParameterAbout[];
  behaviour: Behaviour;
}
