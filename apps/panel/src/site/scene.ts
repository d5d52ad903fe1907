// What stands on the ground: frames, the machine's shapes in them, a second machine as a ghost, paths. Units are metres, z is
// up, the root is the site's frame.

import {
  BoxGeometry, BufferAttribute, BufferGeometry, Color, CylinderGeometry, GridHelper, Group, Line, LineBasicMaterial, LineDashedMaterial,
  Mesh, PerspectiveCamera, Quaternion, Raycaster, Scene, SphereGeometry, Vector2, Vector3, WebGLRenderer, type Material, type Object3D,
} from 'three';
import { OrbitControls } from 'three/addons/controls/OrbitControls.js';
import { colour } from '../dom';
import type { Pose, SceneUpdate, Transforms } from '../messages';
import { solid } from './shade';
import { Terrain } from './terrain';

const BOX = new BoxGeometry(1, 1, 1);
const BALL = new SphereGeometry(0.5, 20, 14);
const ROD = new CylinderGeometry(0.5, 0.5, 1, 20).rotateX(Math.PI / 2);
export const LIVE = ''; // prefix of the machine's own frames

/** How fine: share of the pixels' side, and of the ground's vertices. */
const LEVELS = [
  { pixels: 1, detail: 0 },
  { pixels: 1, detail: 1 },
  { pixels: 0.7, detail: 1 },
  { pixels: 0.5, detail: 2 },
] as const;
const REST_MS = 350;

/** A renderer without a graphics processor: smooth edges cost it more than all else. */
function isSoftware(): boolean {
  const gl = document.createElement('canvas').getContext('webgl2');
  const about = gl?.getExtension('WEBGL_debug_renderer_info');
  const name = gl && about ? String(gl.getParameter(about.UNMASKED_RENDERER_WEBGL)) : '';
  gl?.getExtension('WEBGL_lose_context')?.loseContext();
  return /swiftshader|llvmpipe|software/i.test(name);
}

function place(object: Object3D, pose: Pose): void {
  object.position.set(pose.position.x, pose.position.y, pose.position.z);
  object.quaternion.set(pose.orientation.x, pose.orientation.y, pose.orientation.z, pose.orientation.w);
}

/** A polyline that grows. */
export class Path {
  readonly line: Line;
  private points = new Float32Array(3 * 256);
  private count = 0;

  constructor(material: LineBasicMaterial | LineDashedMaterial) {
    this.line = new Line(new BufferGeometry(), material);
    this.line.frustumCulled = false;
    this.line.renderOrder = 4;
    this.put();
  }

  get length(): number {
    return this.count;
  }

  set(points: { x: number; y: number; z: number }[]): void {
    this.count = 0;
    for (const p of points) this.push(p);
    this.put();
  }

  private push(p: { x: number; y: number; z: number }): void {
    if (3 * this.count + 3 > this.points.length) {
      const more = new Float32Array(2 * this.points.length);
      more.set(this.points);
      this.points = more;
    }
    this.points.set([p.x, p.y, p.z], 3 * this.count++);
  }

  /** Points that are hardly elsewhere are left out; the oldest go. */
  add(p: { x: number; y: number; z: number }): boolean {
    const k = 3 * (this.count - 1);
    const q = this.points;
    if (this.count > 0 && Math.hypot(p.x - q[k], p.y - q[k + 1], p.z - q[k + 2]) < 0.01) return false;
    if (this.count >= 20000) {
      this.points.copyWithin(0, 3 * 5000, 3 * this.count);
      this.count -= 5000;
    }
    this.push(p);
    this.put();
    return true;
  }

  private put(): void {
    const geometry = this.line.geometry;
    const held = geometry.getAttribute('position') as BufferAttribute | undefined;
    if (!held || held.array !== this.points) geometry.setAttribute('position', new BufferAttribute(this.points, 3));
    else held.needsUpdate = true;
    geometry.setDrawRange(0, this.count);
    if (this.line.material instanceof LineDashedMaterial && this.count > 1) this.line.computeLineDistances();
  }
}

/** One machine's frames; all but the first are ghosts. */
class Machine {
  readonly root = new Group();
  readonly frames = new Map<string, Object3D>();
  private readonly drawn = new Map<string, Object3D[]>();

  constructor(readonly ghost: boolean) {}

  frame(name: string): Object3D {
    let f = this.frames.get(name);
    if (!f) {
      f = new Group();
      this.frames.set(name, f);
      this.root.add(f);
    }
    return f;
  }

  /** Whether anything is seen elsewhere than before. */
  transforms(m: Transforms, prefix: string): boolean {
    let moved = false;
    for (const t of m.transforms) {
      const own = (name: string) => (name.startsWith(prefix) ? name.slice(prefix.length) : name);
      const child = this.frame(own(t.child_frame_id));
      const parentName = own(t.parent_frame_id);
      const parent = parentName === 'site' ? this.root : this.frame(parentName);
      if (child.parent !== parent) parent.add(child);
      const { x, y, z, w } = t.rotation;
      const turned = Math.abs(child.quaternion.x - x) + Math.abs(child.quaternion.y - y) + Math.abs(child.quaternion.z - z) + Math.abs(child.quaternion.w - w);
      const far = Math.abs(child.position.x - t.translation.x) + Math.abs(child.position.y - t.translation.y) + Math.abs(child.position.z - t.translation.z);
      if (turned + far < 2e-5) continue;
      moved = true;
      child.position.set(t.translation.x, t.translation.y, t.translation.z);
      child.quaternion.set(x, y, z, w);
    }
    return moved;
  }

  private material(c: { r: number; g: number; b: number; a: number }): Material {
    return this.ghost ? solid(0.3, 0.65, 0.95, 0.38, true) : solid(c.r, c.g, c.b, c.a, false);
  }

  shapes(update: SceneUpdate): void {
    for (const e of update.entities) {
      for (const old of this.drawn.get(e.id) ?? []) old.removeFromParent();
      const made: Object3D[] = [];
      const add = (geometry: BufferGeometry, pose: Pose, size: { x: number; y: number; z: number }, c: { r: number; g: number; b: number; a: number }) => {
        const mesh = new Mesh(geometry, this.material(c));
        place(mesh, pose);
        mesh.scale.set(size.x, size.y, size.z);
        if (this.ghost) mesh.renderOrder = 3;
        this.frame(e.frame_id).add(mesh);
        made.push(mesh);
      };
      for (const s of e.cubes ?? []) add(BOX, s.pose, s.size, s.color);
      for (const s of e.spheres ?? []) add(BALL, s.pose, s.size, s.color);
      for (const s of e.cylinders ?? []) add(ROD, s.pose, s.size, s.color);
      this.drawn.set(e.id, made);
    }
  }

  clear(): void {
    for (const list of this.drawn.values()) for (const o of list) o.removeFromParent();
    this.drawn.clear();
  }
}

export class SiteScene {
  readonly scene = new Scene();
  readonly camera = new PerspectiveCamera(45, 1, 0.1, 2000);
  readonly renderer: WebGLRenderer;
  readonly controls: OrbitControls;
  readonly terrain = new Terrain();
  readonly machine = new Machine(false);
  readonly ghosts = new Map<string, Machine>();
  readonly planned: Path;
  readonly predicted: Path;
  readonly marks = new Group();
  readonly floor: GridHelper;
  private shapes: SceneUpdate | null = null;
  private dirty = true;
  private framed = false;
  private level = 0;
  private fine = true;
  private quick = 0;
  private last_ms = 0;
  private pace_ms = 16;
  /** Frames drawn so far: for the test. */
  frames = 0;

  constructor(
    readonly holder: HTMLElement,
    private readonly seen: () => boolean,
  ) {
    this.renderer = new WebGLRenderer({ antialias: !isSoftware(), powerPreference: 'high-performance' });
    this.renderer.domElement.tabIndex = 0;
    holder.append(this.renderer.domElement);
    this.camera.up.set(0, 0, 1);
    this.camera.position.set(-5, -9, 7);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.target.set(3, 0, 1);
    this.controls.maxPolarAngle = 0.55 * Math.PI;
    this.controls.minDistance = 1;
    this.controls.maxDistance = 300;
    this.controls.addEventListener('change', () => this.draw());
    this.planned = new Path(new LineDashedMaterial({ dashSize: 0.12, gapSize: 0.08, depthTest: false, transparent: true }));
    this.predicted = new Path(new LineBasicMaterial({ depthTest: false, transparent: true, opacity: 0.9 }));
    this.floor = new GridHelper(40, 40).rotateX(Math.PI / 2);
    this.scene.add(this.machine.root, this.terrain.mesh, this.planned.line, this.predicted.line, this.marks, this.floor);
    this.theme();
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.theme());
    new ResizeObserver(() => this.resize()).observe(holder);
    this.resize();
    this.renderer.setAnimationLoop((now: number) => this.drawFrame(now));
  }

  private drawFrame(now: number): void {
    if (!this.seen()) return;
    // At rest once more, as well as it can be.
    if (!this.dirty && !(this.level > 0 && !this.fine && now - this.last_ms > REST_MS)) return;
    this.fine = !this.dirty || this.level === 0;
    if (this.dirty) this.judge(now);
    this.dirty = false;
    this.last_ms = now;
    this.use(this.fine ? LEVELS[0] : LEVELS[this.level]);
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
    this.frames++;
  }

  /** Where frames follow each other slowly they are made coarser, until 30 a second are reached; and finer again. */
  private judge(now: number): void {
    const took = now - this.last_ms;
    if (took > 250) return void (this.pace_ms = Math.min(this.pace_ms, 33)); // there was a rest
    this.pace_ms += 0.2 * (took - this.pace_ms);
    if (this.pace_ms > 36 && this.level + 1 < LEVELS.length) {
      this.level++;
      this.pace_ms = 28;
    } else if (this.pace_ms < 18 && this.level > 0 && ++this.quick > 300) {
      this.level--;
      this.quick = 0;
    }
  }

  private use(level: (typeof LEVELS)[number]): void {
    this.terrain.detail(level.detail);
    const ratio = Math.min(2, devicePixelRatio) * level.pixels;
    if (this.renderer.getPixelRatio() === ratio) return;
    this.renderer.setPixelRatio(ratio);
    this.renderer.setSize(this.holder.clientWidth, this.holder.clientHeight, false);
  }

  theme(): void {
    this.scene.background = new Color(colour('--sky'));
    (this.planned.line.material as LineDashedMaterial).color.set(colour('--p2'));
    (this.predicted.line.material as LineBasicMaterial).color.set(colour('--p1'));
    const grid = this.floor.material as LineBasicMaterial;
    grid.color.set(colour('--edge'));
    grid.vertexColors = false;
    grid.transparent = true;
    grid.opacity = 0.45;
    grid.needsUpdate = true;
    this.draw();
  }

  draw(): void {
    this.dirty = true;
  }

  private resize(): void {
    const w = Math.max(1, this.holder.clientWidth);
    const hgt = Math.max(1, this.holder.clientHeight);
    this.renderer.setSize(w, hgt, false);
    this.camera.aspect = w / hgt;
    this.camera.updateProjectionMatrix();
    this.draw();
  }

  /** Frames of a prefix belong to another machine. */
  transforms(m: Transforms, prefix = LIVE): void {
    if (prefix !== LIVE) {
      if (this.ghost(prefix).transforms(m, `${prefix}/`)) this.draw();
      return;
    }
    const own: Transforms['transforms'] = [];
    const others = new Map<string, Transforms['transforms']>();
    for (const t of m.transforms) {
      const slash = t.child_frame_id.lastIndexOf('/');
      const of = slash > 0 ? t.child_frame_id.slice(0, slash) : LIVE;
      if (of === LIVE) own.push(t);
      else others.set(of, [...(others.get(of) ?? []), t]);
    }
    let moved = this.machine.transforms({ transforms: own }, '');
    for (const [of, list] of others) moved = this.ghost(of).transforms({ transforms: list }, `${of}/`) || moved;
    if (!this.framed && own.length > 0) this.frameView();
    if (moved) this.draw();
  }

  private ghost(prefix: string): Machine {
    let g = this.ghosts.get(prefix);
    if (!g) {
      this.ghosts.set(prefix, (g = new Machine(true)));
      this.scene.add(g.root);
      if (this.shapes) g.shapes(this.shapes);
    }
    return g;
  }

  setShapes(update: SceneUpdate): void {
    this.shapes = update;
    this.machine.shapes(update);
    for (const g of this.ghosts.values()) g.shapes(update);
    this.draw();
  }

  dropGhosts(): void {
    for (const g of this.ghosts.values()) g.root.removeFromParent();
    this.ghosts.clear();
    this.draw();
  }

  /** From behind and aside, all of the machine in view. */
  frameView(): void {
    this.framed = true;
    const at = new Vector3();
    this.machine.root.updateWorldMatrix(true, true);
    const first = this.machine.root.children.find((c) => c.children.length > 0);
    first?.getWorldPosition(at);
    const forward = new Vector3(1, 0, 0);
    if (first) forward.applyQuaternion(first.getWorldQuaternion(new Quaternion()));
    forward.z = 0;
    forward.normalize();
    const right = new Vector3(forward.y, -forward.x, 0);
    this.controls.target.copy(at).addScaledVector(forward, 3.2).add(new Vector3(0, 0, 0.8));
    const away = this.camera.aspect < 1 ? 1.5 : 1;
    this.camera.position.copy(this.controls.target).addScaledVector(forward, -7.5 * away).addScaledVector(right, 10.5 * away).add(new Vector3(0, 0, 6.5 * away));
    this.controls.update();
    this.draw();
  }

  /** A frame of the machine by name; the vehicle's is the first link's. */
  frame(name: string): Object3D {
    if (name === 'site') return this.scene;
    const found = this.machine.frames.get(name);
    return found ?? this.machine.root.children[0] ?? this.scene;
  }

  ray(x: number, y: number): Raycaster {
    const r = new Raycaster();
    this.scene.updateMatrixWorld();
    r.setFromCamera(new Vector2(x, y), this.camera);
    r.params.Line = { threshold: 0.05 };
    return r;
  }

  /** The ground under a place of the canvas (−1 … 1); where there is no map, the level z = 0. */
  ground(x: number, y: number): Vector3 | null {
    const { origin, direction } = this.ray(x, y).ray;
    if (this.terrain.map) return this.terrain.meet(origin, direction);
    const t = -origin.z / direction.z;
    return t > 0 && t < 500 ? origin.clone().addScaledVector(direction, t) : null;
  }
}
