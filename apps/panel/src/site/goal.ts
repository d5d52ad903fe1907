// The desired place of the tool as a ball that can be dragged: in its level plane, with Shift up and down. Dropped, it is
// set; refused, it goes back.

import { BufferGeometry, Group, Line, LineBasicMaterial, Mesh, MeshBasicMaterial, Plane, SphereGeometry, Vector3 } from 'three';
import { colour, number } from '../dom';
import type { Link } from '../link';
import type { SiteScene } from './scene';

const AXES = ['x', 'y', 'z'] as const;

export class Goal {
  readonly root = new Group();
  private readonly ball = new Mesh(new SphereGeometry(1, 20, 14), new MeshBasicMaterial({ depthTest: false, transparent: true, opacity: 0.9 }));
  private readonly stem = new Line(new BufferGeometry().setFromPoints([new Vector3(), new Vector3(0, 0, -1)]), new LineBasicMaterial({ depthTest: false, transparent: true, opacity: 0.7 }));
  private step = '';
  private dragging: { plane: Plane; offset: Vector3; upright: boolean } | null = null;
  private sending = false;
  onTold: (text: string, ok: boolean) => void = () => undefined;

  constructor(
    private readonly site: SiteScene,
    private readonly link: Link,
  ) {
    this.root.add(this.ball, this.stem);
    this.ball.renderOrder = 7;
    this.root.visible = false;
    this.theme();
    matchMedia('(prefers-color-scheme: dark)').addEventListener('change', () => this.theme());
    const canvas = site.renderer.domElement;
    canvas.addEventListener('pointerdown', (e) => this.down(e), { capture: true });
    canvas.addEventListener('pointermove', (e) => this.move(e));
    canvas.addEventListener('pointerup', (e) => void this.up(e));
    canvas.addEventListener('pointercancel', () => this.drop());
  }

  get busy(): boolean {
    return this.dragging !== null || this.sending;
  }

  private theme(): void {
    const tone = colour('--p5');
    (this.ball.material as MeshBasicMaterial).color.set(tone);
    (this.stem.material as LineBasicMaterial).color.set(tone);
    this.site.draw();
  }

  private value(axis: string): number {
    return Number(this.link.parameters.get(`/task/${this.step}/to/${axis}_m`));
  }

  /** As the parameters have it. `step`: "step_1"; "": none. */
  update(step: string): void {
    this.step = step;
    const frame = this.site.frame(this.link.panel?.task_frame === 'site' ? 'site' : '');
    if (this.root.parent !== frame) frame.add(this.root);
    const known = step !== '' && AXES.every((a) => Number.isFinite(this.value(a)));
    this.root.visible = known;
    if (!known || this.busy) return;
    this.root.position.set(this.value('x'), this.value('y'), this.value('z'));
    this.stand();
  }

  private stand(): void {
    const far = this.root.getWorldPosition(new Vector3()).distanceTo(this.site.camera.position);
    this.ball.scale.setScalar(Math.max(0.05, 0.011 * far));
    this.stem.scale.setScalar(Math.max(0.1, this.root.position.z));
    this.site.draw();
  }

  private at(event: PointerEvent): { x: number; y: number } {
    const box = this.site.renderer.domElement.getBoundingClientRect();
    return { x: (2 * (event.clientX - box.left)) / box.width - 1, y: 1 - (2 * (event.clientY - box.top)) / box.height };
  }

  /** Whether the ball is under the pointer, or nearly. */
  private hit(event: PointerEvent): boolean {
    if (!this.root.visible) return false;
    const p = this.root.getWorldPosition(new Vector3()).project(this.site.camera);
    const box = this.site.renderer.domElement.getBoundingClientRect();
    const q = this.at(event);
    return Math.hypot(((p.x - q.x) * box.width) / 2, ((p.y - q.y) * box.height) / 2) < 20;
  }

  private down(event: PointerEvent): void {
    if (event.button !== 0 || this.sending || !this.hit(event)) return;
    event.stopImmediatePropagation();
    if (!this.link.leads) return this.onTold('Take control to move the goal.', false);
    this.site.renderer.domElement.setPointerCapture(event.pointerId);
    this.begin(event);
    this.site.controls.enabled = false;
  }

  private begin(event: PointerEvent): void {
    const world = this.root.getWorldPosition(new Vector3());
    const upright = event.shiftKey;
    const normal = upright ? this.site.camera.position.clone().sub(world).setZ(0).normalize() : new Vector3(0, 0, 1);
    const plane = new Plane().setFromNormalAndCoplanarPoint(normal, world);
    const q = this.at(event);
    const meet = this.site.ray(q.x, q.y).ray.intersectPlane(plane, new Vector3());
    this.dragging = { plane, offset: meet ? world.clone().sub(meet) : new Vector3(), upright };
  }

  private move(event: PointerEvent): void {
    if (!this.dragging) {
      this.site.renderer.domElement.classList.toggle('grab', this.hit(event));
      return;
    }
    if (event.shiftKey !== this.dragging.upright) this.begin(event);
    const q = this.at(event);
    const meet = this.site.ray(q.x, q.y).ray.intersectPlane(this.dragging.plane, new Vector3());
    if (!meet) return;
    const world = meet.add(this.dragging.offset);
    const local = this.root.parent!.worldToLocal(world);
    if (this.dragging.upright) this.root.position.z = local.z;
    else this.root.position.set(local.x, local.y, this.root.position.z);
    this.stand();
    this.onTold(`to ${AXES.map((a) => number(this.root.position[a], 2)).join(', ')} m`, true);
  }

  private drop(): void {
    this.dragging = null;
    this.site.controls.enabled = true;
    this.update(this.step);
  }

  private async up(event: PointerEvent): Promise<void> {
    if (!this.dragging) return;
    this.site.renderer.domElement.releasePointerCapture(event.pointerId);
    this.dragging = null;
    this.site.controls.enabled = true;
    await this.send();
  }

  /** One coordinate after another, as the protocol has it; if one is refused the others go back. */
  private async send(): Promise<void> {
    this.sending = true;
    const done: [string, number][] = [];
    let why = '';
    for (const a of AXES) {
      const name = `/task/${this.step}/to/${a}_m`;
      const before = this.value(a);
      const to = Math.round(this.root.position[a] * 1000) / 1000;
      if (Math.abs(to - before) < 5e-4) continue;
      const answer = await this.link.set(name, to);
      if (!answer.ok) {
        why = answer.text;
        break;
      }
      done.push([name, before]);
    }
    if (why) for (const [name, before] of done.reverse()) await this.link.set(name, before);
    this.sending = false;
    this.update(this.step);
    if (why) this.onTold(`Not set: ${why}`, false);
    else this.onTold(`Desired place set to ${AXES.map((a) => number(this.value(a), 3)).join(', ')} m.`, true);
  }
}
