// The operator's page in a browser: node page.mjs WORK MODE. Started by tests/apps/test_page.py, which says what is proved.
// Prints a line of JSON for each thing that is shown to hold or not.

import { chromium } from 'playwright-core';
import { spawn } from 'node:child_process';
import fs from 'node:fs';
import net from 'node:net';
import os from 'node:os';
import path from 'node:path';

const [work, chrome] = process.argv.slice(2);
const settings = JSON.parse(fs.readFileSync(path.join(work, 'settings.json')));
const pictures = settings.pictures;
fs.mkdirSync(pictures, { recursive: true });
const axe = fs.readFileSync(path.join(import.meta.dirname, 'node_modules/axe-core/axe.min.js'), 'utf8');
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
const check = (ok, text) => console.log(JSON.stringify({ ok: Boolean(ok), text }));
const tell = (text) => console.log(JSON.stringify({ text }));
const SLOW = settings.slow; // times as long

// ---- programs ----

const running = new Set();

/** teledimos panel, at a port of its own. */
async function panel(scenario, name, ...options) {
  const out = path.join(work, name);
  const p = spawn(settings.program, ['panel', scenario, '-o', out, '--port', '0', ...options], { stdio: ['ignore', 'pipe', 'pipe'] });
  running.add(p);
  let text = '';
  p.stdout.on('data', () => undefined);
  const port = await new Promise((done, fail) => {
    p.stderr.on('data', (more) => {
      text += more;
      const found = /panel: wss?:\/\/[^:]+:(\d+)\//.exec(text);
      if (found) done(Number(found[1]));
    });
    p.on('exit', () => fail(new Error(`the panel ended: ${text}`)));
  });
  return {
    port,
    out,
    url: `http://127.0.0.1:${port}/`,
    audit: () =>
      fs.readFileSync(path.join(out, 'audit.jsonl'), 'utf8').split('\n').filter(Boolean).map((l) => JSON.parse(l)),
    end: () =>
      new Promise((done) => {
        p.removeAllListeners('exit');
        p.on('exit', (code) => done(code));
        p.kill('SIGTERM');
        running.delete(p);
      }),
  };
}

/** A TCP relay that can be cut, or told to hold everything back. */
async function relay(to) {
  const pairs = new Set();
  let held = false;
  const server = net.createServer((a) => {
    const b = net.connect(to, '127.0.0.1');
    pairs.add(a).add(b);
    for (const [x, y] of [[a, b], [b, a]]) {
      x.on('data', (bytes) => !held && y.write(bytes));
      x.on('error', () => undefined);
      x.on('close', () => y.destroy());
    }
  });
  const listen = (port) => new Promise((done) => server.listen(port, '127.0.0.1', () => done(server.address().port)));
  const port = await listen(0);
  const drop = () => {
    for (const s of pairs) s.destroy();
    pairs.clear();
  };
  return {
    port,
    cut: () => {
      server.close();
      drop();
    },
    restore: () => listen(port),
    hold: (on) => {
      held = on;
      if (!on) drop();
    },
  };
}

// ---- a browser ----

let browser;
const faults = [];

async function open(url, how = {}) {
  const context = await browser.newContext({ viewport: { width: 1440, height: 900 }, colorScheme: 'light', ...how });
  const page = await context.newPage();
  page.on('pageerror', (e) => faults.push(e.message));
  page.on('console', (m) => {
    // A connection that is cut, and one that is not let in, are told by the browser itself.
    if (m.type() === 'error' && !/WebSocket connection|ERR_|Failed to load resource/.test(m.text())) faults.push(m.text());
  });
  await page.goto(url);
  return page;
}

const until = async (page, f, argument, ms = 10000) => {
  try {
    await page.waitForFunction(f, argument, { timeout: ms * SLOW, polling: 50 });
    return true;
  } catch {
    return false;
  }
};
const phaseIs = (page, word, ms) => until(page, (w) => document.body.dataset.phase.startsWith(w), word, ms);
const live = (page) => until(page, () => document.body.dataset.link === 'live');
const text = (page, selector) => page.locator(selector).first().innerText();
const show = (page, view) => page.click(`nav a[href="#${view}"]`);
const picture = (page, name, full = true) => page.screenshot({ path: path.join(pictures, `${name}.png`), fullPage: full });

/** Types into a field, and waits until it is answered. */
async function put(page, name, value) {
  const field = page.locator(`.simulate [name="${name}"]`);
  if ((await field.evaluate((e) => e.tagName)) === 'SELECT') await field.selectOption(value);
  else {
    await field.fill(value);
    await field.press('Enter');
  }
  await until(page, (n) => !document.querySelector(`.simulate [name="${n}"]`).closest('.field').classList.contains('busy'), name);
  await sleep(60);
  return page.locator('.simulate .field', { has: page.locator(`[name="${name}"]`) }).locator('.error').innerText().catch(() => '');
}

const cell = async (page, table, row, column) =>
  Number((await page.locator(`[aria-label="${table}"] tbody tr`).nth(row).locator('td').nth(column).innerText()).replace('−', '-'));
const toolAt = (page, axis, column = 1) => cell(page, 'The tool’s place, desired and actual', axis, column);
const jointAt = (page, joint, column = 1) => cell(page, 'The joints, desired and actual', joint, column);
/** A joint does not move any more. */
async function stands(page, joint) {
  for (let k = 0, last = NaN; k < 20 * SLOW; k++) {
    const now = await jointAt(page, joint);
    if (Math.abs(now - last) < 0.02) return true;
    last = now;
    await sleep(400);
  }
  return false;
}
const points = (page) => page.locator('.plot').evaluateAll((list) => list.map((e) => Number(e.dataset.points)));

// ---- what is shown ----

async function firstLoad(url) {
  const begun = performance.now();
  const page = await open(url);
  await live(page);
  const took = performance.now() - begun;
  const bytes = await page.evaluate(() =>
    [...performance.getEntriesByType('navigation'), ...performance.getEntriesByType('resource')].reduce((sum, e) => sum + e.transferSize, 0),
  );
  const painted = await page.evaluate(() => performance.getEntriesByName('first-contentful-paint')[0]?.startTime ?? NaN);
  tell(`first load: seen after ${painted.toFixed(0)} ms, live after ${took.toFixed(0)} ms, ${(bytes / 1024).toFixed(0)} KiB`);
  check(took < 2000 * SLOW, `the page is live ${took.toFixed(0)} ms after it was asked for`);
  check(bytes > 10000 && bytes < 300000, `its first load is ${bytes} bytes`);
  return page;
}

/** The paper's session: parameters, StartSim, Pause, Resume, the end; a pose out of reach, Reinit; UserStop. */
async function session(page, server) {
  check(await page.locator('#order-StartSim').isDisabled(), 'without control no order can be given');
  await page.click('#take');
  check(await until(page, () => document.body.classList.contains('leads')), 'control is taken');
  await phaseIs(page, 'ready');
  for (const [name, value, held] of [
    ['/simulation/duration_s', '4', 4],
    ['/task/step_1/duration_s', '2.5', 2.5],
    ['/task/step_1/law', 'cubic', 'cubic'],
    ['/generator/alpha', '-2', -2],
    ['/generator/power', '8', 8],
    ['/task/step_1/to/x_m', '7', 7],
    ['/task/step_1/to/y_m', '1', 1],
    ['/task/step_1/to/z_m', '1,2', 1.2],
    ['/task/step_1/via_1/x_m', '6.8', 6.8],
  ]) {
    const why = await put(page, name, value);
    const order = server.audit().filter((l) => l.what === 'order' && l.parameter === name).pop();
    check(why === '' && order?.value === held, `${name} is set to ${value}: ${why || JSON.stringify(order?.value)}`);
  }
  let why = await put(page, '/generator/power', '1000');
  check(/1 to 100/.test(why), `a power out of range is refused under its field: ${why}`);
  why = await put(page, '/generator/power', 'six');
  check(/no number/.test(why), `so is a word: ${why}`);
  await put(page, '/generator/power', '6');
  why = await put(page, '/task/step_1/to/x_m', '50');
  check(/reach|first joint|long/.test(why) && /7 holds/.test(why), `a goal beyond the arm, by the server's own words: ${why}`);
  why = await put(page, '/task/step_1/to/x_m', '7');
  check(why === '', 'and the field is well again');

  await sleep(300);
  const before = await points(page);
  await page.click('#order-StartSim');
  check(await phaseIs(page, 'simulating'), 'StartSim');
  await sleep(600);
  const after = await points(page);
  check(after.length === 4 && after.every((n, i) => n > before[i] + 5), `the curves grow: ${before} to ${after} samples`);
  await page.keyboard.press(' ');
  check(await phaseIs(page, 'the simulation is paused'), 'Pause, by its key');
  check(await stands(page, 0), 'nothing moves');
  check(await page.locator('g.phase.now').first().textContent().then((t) => /paused/i.test(t)), 'the diagram shows where it stands');
  await page.click('#order-Resume');
  await phaseIs(page, 'simulating');
  await sleep(400);
  await picture(page, 'simulate-light');
  check(await phaseIs(page, 'simulated to the end', 12000), 'Resume, and the end');
  await sleep(300);
  const at = [await toolAt(page, 0, 0), await toolAt(page, 1, 0), await toolAt(page, 2, 0)];
  const off = [await toolAt(page, 0, 2), await toolAt(page, 1, 2), await toolAt(page, 2, 2)];
  check(Math.abs(at[0] - 7) < 0.05 && Math.abs(at[1] - 1) < 0.05 && Math.abs(at[2] - 1.2) < 0.06 && off.every((mm) => Math.abs(mm) < 30),
    `the tool is where it was wanted: ${at} m, off by ${off} mm`);
  await page.click('#order-Validate');
  check(await phaseIs(page, 'validated'), 'Validate');
  check(await page.locator('#order-Download').isDisabled(), 'there is no machine to download to');
  await page.click('#order-Reinit');
  await phaseIs(page, 'ready');

  await put(page, '/task/step_1/duration_s', '6');
  why = await put(page, '/task/step_1/to/x_m', '10.2');
  await page.click('#order-StartSim');
  check(await phaseIs(page, 'failed'), `a pose out of reach fails: ${why}`);
  await sleep(300);
  check(/out of reach/.test(await text(page, '.why')) && /nearest place/.test(await text(page, '.why')), `and says why: ${(await text(page, '.why')).slice(0, 90)}`);
  await picture(page, 'failed-light');
  await page.keyboard.press('r');
  check(await phaseIs(page, 'ready'), 'Reinit, by its key');
  await put(page, '/task/step_1/to/x_m', '7');
  await put(page, '/task/step_1/duration_s', '2.5');
  await page.click('#order-StartSim');
  await phaseIs(page, 'simulating');
  await show(page, 'site');
  await page.keyboard.press('Escape');
  check(await phaseIs(page, 'nothing is prepared', 3000), 'Escape is UserStop, in another view too');
  await show(page, 'simulate');
  await page.click('#order-Prepare');
  await phaseIs(page, 'ready');
}

async function byHand(page) {
  await page.click('#order-Manual');
  await phaseIs(page, 'manual');
  const boom = await jointAt(page, 1);
  const button = page.getByLabel('boom forwards, hold');
  await button.hover();
  const passes = async (degrees, sign) => {
    for (let k = 0; k < 25 * SLOW; k++) {
      if (sign * ((await jointAt(page, 1)) - degrees) > 0) return true;
      await sleep(200);
    }
    return false;
  };
  await page.mouse.down();
  check(await passes(boom + 1, 1), `the boom moves from ${boom}° while its button is held`);
  await page.mouse.up();
  check(await stands(page, 1), 'and stands when it is let go');
  const there = await jointAt(page, 1);
  await page.locator('h2').first().click();
  await page.keyboard.down('ArrowDown');
  check(await passes(there - 1, -1), 'back by its key');
  await page.keyboard.up('ArrowDown');
  check(await stands(page, 1), 'and stands');
  await page.click('#order-Automatic');
  await phaseIs(page, 'ready');
}

async function watcher(url) {
  const page = await open(url, { viewport: { width: 390, height: 844 }, deviceScaleFactor: 2, colorScheme: 'dark', hasTouch: true });
  await live(page);
  check(/Client \d+ leads/.test(await text(page, '.holder')), `another is told who leads: ${await text(page, '.holder')}`);
  const wide = await page.evaluate(() => document.documentElement.scrollWidth);
  check(wide <= 390, `on a phone nothing is wider than the screen: ${wide} px`);
  await sleep(500);
  await picture(page, 'simulate-phone-dark');
  await show(page, 'site');
  await until(page, () => document.querySelector('.canvas canvas'));
  await sleep(900);
  check((await page.evaluate(() => document.documentElement.scrollWidth)) <= 390, 'nor in the other view');
  await picture(page, 'site-phone-dark');
  await page.context().close();
}

/** Where a place of the site is seen, px. */
const seenAt = (page, p) =>
  page.evaluate(([x, y, z]) => {
    const site = document.querySelector('.canvas').site;
    const v = site.controls.target.clone().set(x, y, z);
    site.camera.updateMatrixWorld();
    v.project(site.camera);
    const box = site.renderer.domElement.getBoundingClientRect();
    return [box.left + ((v.x + 1) / 2) * box.width, box.top + ((1 - v.y) / 2) * box.height];
  }, p);
const ball = (page) =>
  page.evaluate(() => {
    const p = document.querySelector('.canvas').view.goal.root.getWorldPosition(document.querySelector('.canvas').site.controls.target.clone());
    return [p.x, p.y, p.z];
  });

/** A second machine's frames, as they come on /measured/tf: its links where it says, seen through. */
async function ghost(page) {
  await show(page, 'site');
  await until(page, () => document.querySelector('.canvas')?.site?.machine.frames.has('boom'));
  const seen = await page.evaluate(() => {
    const { site } = document.querySelector('.canvas');
    const transforms = [...site.machine.frames].map(([name, f]) => {
      const parent = [...site.machine.frames].find(([, g]) => g === f.parent)?.[0];
      return {
        parent_frame_id: parent ? `measured/${parent}` : 'site',
        child_frame_id: `measured/${name}`,
        translation: { x: f.position.x + (parent ? 0 : 1), y: f.position.y, z: f.position.z },
        rotation: { x: f.quaternion.x, y: f.quaternion.y, z: f.quaternion.z, w: f.quaternion.w },
      };
    });
    site.transforms({ transforms }, 'measured');
    site.scene.updateMatrixWorld(true);
    const g = site.ghosts.get('measured');
    let meshes = 0;
    let clear = 0;
    g.root.traverse((o) => o.isMesh && (meshes++, (clear += o.material.transparent ? 1 : 0)));
    const at = (m) => m.frames.get('bucket').getWorldPosition(site.controls.target.clone()).x;
    return { meshes, clear, off: at(g) - at(site.machine) };
  });
  await sleep(700);
  await picture(page, 'ghost-light', false);
  check(seen.meshes > 5 && seen.clear === seen.meshes && Math.abs(seen.off - 1) < 1e-3, `a measured machine is a ghost beside the other: ${JSON.stringify(seen)}`);
  await page.evaluate(() => document.querySelector('.canvas').site.dropGhosts());
}

/** The desired place, dragged. */
async function dragging(page, server) {
  await show(page, 'site');
  await until(page, () => document.querySelector('.canvas')?.view?.goal.root.visible);
  await sleep(600);
  const drag = async (to) => {
    const from = await ball(page);
    const [a, b] = [await seenAt(page, from), await seenAt(page, [to[0], to[1], from[2]])];
    await page.mouse.move(a[0], a[1]);
    await page.mouse.down();
    await page.mouse.move((a[0] + b[0]) / 2, (a[1] + b[1]) / 2, { steps: 4 });
    await page.mouse.move(b[0], b[1], { steps: 4 });
    await page.mouse.up();
    await until(page, () => !document.querySelector('.canvas').view.goal.busy);
    await sleep(100);
    return text(page, '.site .told');
  };
  const told = await drag([7.6, -1.5]);
  const set = (name) => server.audit().filter((l) => l.what === 'order' && l.parameter === name).pop()?.value;
  check(Math.abs(set('/task/step_1/to/x_m') - 7.6) < 0.1 && Math.abs(set('/task/step_1/to/y_m') + 1.5) < 0.1, `the ball, dropped, sets the pose: ${told}`);
  // Seen from above, far away is on the screen.
  await page.evaluate(() => {
    const site = document.querySelector('.canvas').site;
    site.camera.position.set(6, -0.1, 40);
    site.controls.target.set(6, 0, 0);
    site.controls.update();
    site.draw();
  });
  await sleep(300);
  const refused = await drag([13, -3]);
  check(/Not set/.test(refused), `out of reach it is refused, visibly: ${refused}`);
  const back = await ball(page);
  check(Math.abs(back[0] - 7.6) < 0.15, `and goes back: ${back.map((v) => v.toFixed(2))}`);
  await page.keyboard.press('f');
}

/** On a map of known shape: a pit of 2 × 1.5 × 0.5 m, and a length. */
async function measuring(server) {
  const page = await open(`${server.url}#site`);
  await live(page);
  await until(page, () => document.querySelector('.canvas')?.site?.terrain.map);
  await page.evaluate(() => {
    const site = document.querySelector('.canvas').site;
    site.camera.position.set(9, -3.2, 9);
    site.controls.target.set(9, -3, 0);
    site.controls.update();
    site.draw();
  });
  await sleep(500);
  const click = async (p) => page.mouse.click(...(await seenAt(page, p)));
  await page.locator('label', { hasText: /^Line$/ }).click();
  await click([7, -1, 0]);
  await click([10, -1, 0]);
  await until(page, () => /length/.test(document.querySelector('.site .result').textContent));
  const line = await text(page, '.site .result');
  const length = Number(/length ([\d.]+)/.exec(line)?.[1]);
  check(Math.abs(length - 3) < 0.03 && /±/.test(line), `a line of 3 m: ${line.replaceAll('\n', '; ')}`);
  await page.locator('label', { hasText: /^Volume$/ }).click();
  for (const p of [[7.5, -4.5], [10.5, -4.5], [10.5, -2], [7.5, -2]]) await click([...p, 0]);
  await page.locator('canvas').focus();
  await page.keyboard.press('Shift+Enter');
  const pit = await text(page, '.site .result');
  const below = Number(/plane of its corners ([\d.]+)/.exec(pit)?.[1]);
  check(Math.abs(below - 1.5) < 0.08 && Math.abs(Number(/area ([\d.]+)/.exec(pit)?.[1]) - 7.5) < 0.15 && /σ/.test(pit), `a pit of 1.5 m³: ${pit.replaceAll('\n', '; ')}`);
  await picture(page, 'measure-light', false);
  for (const [name, word] of [['σ', 'σ of the height'], ['Provenance', 'from'], ['Change', 'now less before'], ['Height', 'Height']]) {
    await page.locator('label', { hasText: new RegExp(`^${name}$`) }).click();
    await sleep(150);
    check((await text(page, '.scale')).includes(word), `the ground in the colours of its ${name}, with a legend`);
    if (name === 'Provenance') await picture(page, 'provenance-light', false);
  }
  await page.context().close();
}

/** Processor seconds of the browser's processes so far. */
function spent() {
  const parents = new Map();
  const used = new Map();
  for (const pid of fs.readdirSync('/proc').filter((n) => /^\d+$/.test(n)))
    try {
      const row = fs.readFileSync(`/proc/${pid}/stat`, 'utf8').split(') ')[1].split(' ');
      parents.set(Number(pid), Number(row[1]));
      used.set(Number(pid), (Number(row[11]) + Number(row[12])) / 100);
    } catch {
      continue; // it is gone
    }
  const ours = (pid) => pid === process.pid || (parents.has(pid) && ours(parents.get(pid)));
  const servers = new Set([...running].map((p) => p.pid));
  return [...used].filter(([pid]) => pid !== process.pid && !servers.has(pid) && ours(pid)).reduce((sum, [, s]) => sum + s, 0);
}

async function pace(server) {
  const page = await open(`${server.url}#site`);
  await live(page);
  await until(page, () => document.querySelector('.canvas')?.site?.terrain.map);
  await page.click('#take');
  await show(page, 'simulate');
  await page.click('#order-StartSim');
  await show(page, 'site');
  await phaseIs(page, 'simulating');
  const found = await page.evaluate(async () => {
    const { site } = document.querySelector('.canvas');
    const run = async (ms) => {
      const from = site.frames;
      const begun = performance.now();
      let on = true;
      const spin = () => {
        site.draw();
        if (on) requestAnimationFrame(spin);
      };
      spin();
      await new Promise((done) => setTimeout(done, ms));
      on = false;
      return (site.frames - from) / ((performance.now() - begun) / 1000);
    };
    window.spin = run;
    await run(2500); // it finds how fine it can be
    const gl = site.renderer.getContext();
    const about = gl.getExtension('WEBGL_debug_renderer_info');
    return { triangles: site.renderer.info.render.triangles, level: site.level, by: about ? gl.getParameter(about.UNMASKED_RENDERER_WEBGL) : '' };
  });
  const before = [spent(), await page.evaluate(() => document.querySelector('.canvas').site.frames)];
  found.rate = await page.evaluate(() => window.spin(3000));
  const frames = (await page.evaluate(() => document.querySelector('.canvas').site.frames)) - before[1];
  const each = (1000 * (spent() - before[0])) / frames;
  const facts = await text(page, '.site .path');
  check(/clearance/.test(facts) && /probability/.test(facts), `the motion ahead, with what the map says of it: ${facts.replaceAll('\n', ' ')}`);
  tell(`a map of 500 × 500 with the machine and its paths: ${found.rate.toFixed(1)} frames a second, ${each.toFixed(0)} ms of a processor each (${found.triangles} triangles, fineness ${found.level}; ${found.by.slice(0, 60)})`);
  // On a machine that does other things too: what its processors could do.
  check(found.rate >= 30 || each <= (1000 / 30) * os.cpus().length, `30 frames a second: ${found.rate.toFixed(1)}, at ${each.toFixed(0)} ms each`);
  await phaseIs(page, 'simulated', 12000);
  await sleep(1200);
  await picture(page, 'site-light', false);
  await page.setViewportSize({ width: 1200, height: 675 });
  await sleep(900);
  await picture(page, 'page', false); // for the README: apps/panel/page.png
  await page.setViewportSize({ width: 1440, height: 900 });
  await page.emulateMedia({ colorScheme: 'dark' });
  await sleep(900);
  await picture(page, 'site-dark', false);
  await page.context().close();
}

/** A recording from disk: what is drawn at a time is what the file holds then, read here without its index. */
async function replay(server, file, seeks, name) {
  const truth = settings.truth[name];
  const page = await open(`${server.url}#site`);
  await live(page);
  await until(page, () => document.querySelector('.canvas')?.site);
  await page.setInputFiles('input[type=file]', file);
  check(await until(page, () => !document.querySelector('.player').hidden), `${name}: opened`);
  const slider = page.getByLabel('Time in the recording');
  let wrong = 0;
  for (const [time, q] of truth) {
    await slider.evaluate((e, t) => {
      e.value = String(t);
      e.dispatchEvent(new Event('input'));
    }, time);
    await until(page, (t) => Math.abs(document.querySelector('.canvas').view.player.time_s - t) < 1e-6, time);
    const seen = await page.evaluate(() => {
      const f = document.querySelector('.canvas').site.machine.frames.get('boom');
      return [f.quaternion.x, f.quaternion.y, f.quaternion.z, f.quaternion.w];
    });
    if (Math.max(...seen.map((v, i) => Math.abs(v - q[i]))) > 1e-4) wrong++;
  }
  check(wrong === 0 && truth.length > 5, `${name}: at ${truth.length} times the machine is drawn as it was, ${wrong} wrong`);
  const [low, high] = await slider.evaluate((e) => [Number(e.min), Number(e.max)]);
  const longest = await page.evaluate(async ([from, to, n]) => {
    const e = document.querySelector('[aria-label="Time in the recording"]');
    const { view } = document.querySelector('.canvas');
    let most = 0;
    for (let i = 0; i < n; i++) {
      const begun = performance.now();
      const t = from + ((to - from) * ((i * 7919) % n)) / n;
      e.value = String(t);
      e.dispatchEvent(new Event('input'));
      while (Math.abs(view.player.time_s - Number(e.value)) > 1e-3 && performance.now() - begun < 3000) await new Promise((d) => requestAnimationFrame(d));
      most = Math.max(most, performance.now() - begun);
    }
    return [most, view.player.slowest_ms];
  }, [low, high, seeks]);
  tell(`${name}: ${((high - low) / 60).toFixed(1)} min, ${(fs.statSync(file).size / 1048576).toFixed(1)} MiB: the slowest of ${seeks} seeks ${longest[1].toFixed(0)} ms, shown after ${longest[0].toFixed(0)} ms`);
  check(longest[1] < 200 * SLOW, `${name}: no seek takes 200 ms: ${longest[1].toFixed(0)} ms`);
  check(/not live/.test(await text(page, '.source')), 'a recording is never taken for live');
  await picture(page, `recording-${name}`, false);
  await page.getByText('Back to live').click();
  check(await until(page, () => document.querySelector('.source').hidden), 'and back to live');
  fs.writeFileSync(path.join(work, 'bad.mcap'), 'this is not one');
  await page.setInputFiles('input[type=file]', path.join(work, 'bad.mcap'));
  await sleep(300);
  check(/no MCAP/.test(await text(page, '.site .error:not([hidden])')), 'a file that is none is told');
  await page.context().close();
}

async function linkDown(server) {
  const between = await relay(server.port);
  const page = await open(`http://127.0.0.1:${between.port}/`);
  check(await live(page), 'over the relay it is live');
  await page.click('#take');
  await until(page, () => document.body.classList.contains('leads'));
  const lostAfter = async (act) => {
    const begun = performance.now();
    act();
    const told = await until(page, () => document.body.classList.contains('lost') && !document.querySelector('.notice').hidden);
    return told ? performance.now() - begun : Infinity;
  };
  let took = await lostAfter(() => between.cut());
  check(took < 2000, `a link that is cut is told after ${took.toFixed(0)} ms`);
  await sleep(900);
  const ages = await page.locator('.card .age').allInnerTexts();
  check(ages.length > 4 && ages.every((t) => / old$/.test(t)), `everything is marked with its age: ${ages[0]}`);
  check((await page.locator('.orders button:enabled').count()) === 0, 'no order can be given');
  check((await page.locator('#link').innerText()).includes('old'), `and the link says so: ${await text(page, '#link')}`);
  await picture(page, 'link-down-light');
  await scan(page, 'link down');
  await between.restore();
  check(await live(page), 'it connects again by itself');
  check((await page.locator('.card .age').allInnerTexts()).every((t) => t === '') && (await page.locator('.notice').isHidden()), 'and the marks are gone');
  took = await lostAfter(() => between.hold(true));
  check(took < 2000, `a link that hangs is told after ${took.toFixed(0)} ms`);
  between.hold(false);
  check(await live(page), 'and it is live again');
  await page.context().close();
  between.cut();
}

/** A task that was validated here, done by a machine in a process of its own. */
async function machine() {
  const far = spawn(settings.program, ['machine', settings.ground, '--listen', '127.0.0.1:0', '--token-file', settings.token_file, '-o', path.join(work, 'far'), '--image-rate', '0', '--period', '0.5'], { stdio: ['ignore', 'pipe', 'ignore'] });
  running.add(far);
  const port = await new Promise((done) => far.stdout.on('data', (text) => done(String(text).trim().split(/\s+/).pop())));
  const server = await panel(settings.ground, 'led', '--machine', `127.0.0.1:${port}`, '--machine-token-file', settings.token_file, '--machine-period', '0.5');
  const page = await open(server.url);
  await live(page);
  await page.click('#take');
  await phaseIs(page, 'ready');
  check(await until(page, () => /open/.test(document.querySelector('#machine')?.innerText ?? '')), `the machine's link is told: ${(await text(page, '#machine')).replace(/\s+/g, ' ')}`);
  const from = await jointAt(page, 0);
  check(await page.locator('#order-Execute').isDisabled(), 'what is not validated cannot be executed');
  await page.click('#order-StartSim');
  check(await phaseIs(page, 'simulated to the end', 20000), 'simulated');
  await page.click('#order-Validate');
  check(await phaseIs(page, 'validated'), 'validated');
  await page.click('#order-Download');
  check(await phaseIs(page, 'the machine holds the task', 20000), 'the machine has checked it by itself, and holds it');
  await page.click('#order-Execute');
  check(await phaseIs(page, 'the machine executes'), 'it executes');
  await sleep(1500);
  await picture(page, 'machine-light');
  await show(page, 'site');
  check(await until(page, () => (document.querySelector('.canvas')?.site?.ghosts.get('measured')?.frames.size ?? 0) > 3), 'its measured place is a ghost in the site');
  await picture(page, 'machine-site-light', false);
  await show(page, 'simulate');
  check(await phaseIs(page, 'executed', 20000), 'to the end');
  await sleep(500);
  const apart = await page.evaluate(() => {
    const { site } = document.querySelector('.canvas');
    site.scene.updateMatrixWorld(true);
    const at = (m) => m.frames.get('bucket').getWorldPosition(site.controls.target.clone());
    return at(site.machine).distanceTo(at(site.ghosts.get('measured')));
  });
  const to = await jointAt(page, 0);
  check(apart < 0.05 && Math.abs(to - from) > 5, `the measured bucket is ${(1e3 * apart).toFixed(1)} mm from the predicted, the swing went from ${from}° to ${to}°`);
  await page.context().close();
  await server.end();
  far.kill('SIGTERM');
  running.delete(far);
}

async function door(scenario) {
  const server = await panel(scenario, 'door', '--token-file', settings.token_file);
  const stranger = await open(server.url);
  check(await until(stranger, () => !document.querySelector('.notice').hidden && /token/.test(document.querySelector('.notice').textContent)), 'without its token the page says what is missing');
  check(await stranger.locator('#take').isHidden(), 'and shows nothing');
  await stranger.context().close();
  const page = await open(`${server.url}?token=${settings.token}`);
  check(await live(page), 'with its token the page is live');
  check(!page.url().includes(settings.token), `and the token is gone from its address: ${page.url()}`);
  await page.reload();
  check(await live(page), 'a reload keeps it');
  await page.context().close();
  await server.end();
}

// ---- what everybody can use ----

async function scan(page, name) {
  const result = await page.evaluate(async (source) => {
    if (!window.axe) new Function(source)();
    return await window.axe.run(document, { resultTypes: ['violations'] });
  }, axe);
  const what = result.violations.map((v) => `${v.id} (${v.nodes.length}: ${v.nodes[0].target})`);
  check(what.length === 0, `axe-core finds nothing in ${name}: ${what.join(', ')}`);
}

async function forAll(server) {
  for (const colorScheme of ['light', 'dark'])
    for (const width of [1440, 390]) {
      const page = await open(server.url, { colorScheme, viewport: { width, height: 844 }, bypassCSP: true });
      await live(page);
      await sleep(400);
      const views = await page.locator('nav a').evaluateAll((list) => list.map((a) => a.getAttribute('href').slice(1)));
      for (const view of views) {
        await show(page, view);
        await sleep(view === 'site' ? 1500 : 400);
        await scan(page, `${view}, ${colorScheme}, ${width} px`);
        if (width === 1440 && colorScheme === 'dark' && view !== 'site') await picture(page, `${view}-dark`);
      }
      await page.context().close();
    }
}

/** Reached by Tab alone, each with a name and a visible focus. */
async function keyboard(server) {
  const page = await open(server.url);
  await live(page);
  const seen = new Set();
  let bare = 0;
  for (let i = 0; i < 60; i++) {
    await page.keyboard.press('Tab');
    const at = await page.evaluate(() => {
      const e = document.activeElement;
      const box = e.closest('.input') ?? e;
      const style = getComputedStyle(box);
      const hidden = e.matches('.choice input') ? getComputedStyle(e.nextElementSibling) : style;
      return { id: e.id || e.getAttribute('href') || e.tagName, ring: hidden.outlineStyle !== 'none' || style.outlineStyle !== 'none', body: e === document.body };
    });
    if (at.body) break;
    seen.add(at.id);
    if (!at.ring) bare++;
  }
  check(['#simulate', '#site', 'take', 'stop'].every((id) => seen.has(id)) && bare === 0, `all is reached by Tab: ${seen.size} stops, ${bare} without a ring`);
  await page.context().close();
}

/** With Mesa's renderer, which is the faster one without a graphics processor; else with Chromium's own. */
async function launch() {
  for (const args of [['--use-angle=gl-egl', '--ignore-gpu-blocklist'], ['--use-angle=swiftshader', '--enable-unsafe-swiftshader']]) {
    browser = await chromium.launch({ executablePath: chrome, args: ['--no-sandbox', '--use-gl=angle', ...args] });
    const page = await browser.newPage();
    const draws = await page.evaluate(() => document.createElement('canvas').getContext('webgl2') !== null).catch(() => false);
    await page.close().catch(() => undefined);
    if (draws) return;
    await browser.close();
  }
  check(false, 'the browser has WebGL 2');
}

async function main() {
  await launch();
  const parts = {
    session: async () => {
      const server = await panel(settings.scenario, 'session');
      const page = await firstLoad(server.url);
      await session(page, server);
      await byHand(page);
      await watcher(server.url);
      await ghost(page);
      await dragging(page, server);
      await page.context().close();
      await server.end();
    },
    ground: async () => {
      if (!settings.ground) return;
      const server = await panel(settings.ground, 'ground');
      await measuring(server);
      await pace(server);
      await server.end();
    },
    replay: async () => {
      const server = await panel(settings.scenario, 'replay');
      for (const [name, file] of Object.entries(settings.recordings)) await replay(server, file, name === 'hour' ? 200 : 60, name);
      await server.end();
    },
    link: async () => {
      const server = await panel(settings.scenario, 'link');
      await linkDown(server);
      await server.end();
    },
    machine: async () => {
      if (settings.ground) await machine();
    },
    door: () => door(settings.scenario),
    all: async () => {
      const server = await panel(settings.scenario, 'all');
      await forAll(server);
      await keyboard(server);
      await server.end();
    },
  };
  for (const [name, part] of Object.entries(parts)) {
    if (settings.only && !settings.only.split(',').includes(name)) continue;
    const begun = performance.now();
    try {
      await part();
    } catch (e) {
      check(false, `${name}: ${String(e.stack ?? e).slice(0, 700)}`);
    }
    tell(`${name}: ${((performance.now() - begun) / 1000).toFixed(1)} s`);
  }
  check(faults.length === 0, `no error in the browser's console: ${faults.slice(0, 3)}`);
  await browser.close();
}

await main().finally(() => {
  for (const p of running) p.kill('SIGKILL');
});
