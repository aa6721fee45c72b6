// The camera: turned, moved and zoomed by mouse, pen or fingers around a target; presets; a body that is followed.

const DIRECTIONS = {front: [1, 0, 0], side: [0, -1, 0], top: [0, -1e-3, 1]};
const STEEPEST = Math.PI / 2 - 1e-3;

class Orbit {
  constructor(stage, camera) {
    this.stage = stage;
    this.chosen = camera;
    this.target = new THREE.Vector3();
    this.margins = () => [0, 0];  // [px] that panels cover above and below
    this.fingers = new Map();
    const pane = stage.renderer.domElement;
    pane.style.touchAction = "none";
    pane.addEventListener("pointerdown", event => {
      pane.setPointerCapture(event.pointerId);
      this.fingers.set(event.pointerId, event);
    });
    for (const name of ["pointerup", "pointercancel"]) {
      pane.addEventListener(name, event => this.fingers.delete(event.pointerId));
    }
    pane.addEventListener("pointermove", event => this.drag(event));
    pane.addEventListener("wheel", event => {
      event.preventDefault();
      this.zoom(Math.exp(0.0015 * Math.max(-200, Math.min(200, event.deltaY))));
    }, {passive: false});
    pane.addEventListener("contextmenu", event => event.preventDefault());
    stage.resized = () => { if (!this.touched) { this.choose(this.chosen); } };
  }

  // camera: {preset}, {eye, target} or {follow: place of a body}.
  choose(camera) {
    this.chosen = camera;
    this.touched = false;
    this.followed = null;
    if (camera.eye) {
      this.target.set(...camera.target);
      this.look(new THREE.Vector3(...camera.eye).sub(this.target));
    } else if (camera.follow !== undefined && camera.follow !== null) {
      this.follow(camera.follow);
    } else {
      this.fit(DIRECTIONS[camera.preset] || this.stage.view.direction);
    }
    const [x, y] = this.stage.camera.position.clone().sub(this.target).normalize().toArray();
    this.stage.aim(x, y);
  }

  // Look from a direction so that all of the outline is in the picture, as large as it can be.
  fit(direction) {
    const {view, stage} = {view: this.stage.view, stage: this.stage};
    const d = new THREE.Vector3(...direction).normalize(), side = new THREE.Vector3(0, 0, 1).cross(d).normalize();
    const up = d.clone().cross(side), center = new THREE.Vector3(...view.center), point = new THREE.Vector3();
    const half = Math.tan(stage.camera.fov * Math.PI / 360), [above, below] = this.margins();
    const right = 0.95 * half * stage.camera.aspect;
    const top = half * Math.max(0.3, 0.95 - 2 * above / stage.height);
    const bottom = half * Math.max(0.3, 0.95 - 2 * below / stage.height);
    const most = [-Infinity, -Infinity, -Infinity, -Infinity];
    let nearest = -Infinity;
    for (const place of view.outline) {
      point.set(...place).sub(center);
      const x = point.dot(side), y = point.dot(up), z = point.dot(d);
      [x + right * z, -x + right * z, y + top * z, -y + bottom * z].forEach((reach, k) => {
        most[k] = Math.max(most[k], reach);
      });
      nearest = Math.max(nearest, z);
    }
    // A point is seen where x - cx <= right (cz - z), and so on: the nearest camera that sees all of them.
    const cz = Math.max((most[0] + most[1]) / (2 * right), (most[2] + most[3]) / (top + bottom),
      nearest + 0.1 * view.radius);
    const cx = (most[0] - most[1]) / 2, cy = (bottom * most[2] - top * most[3]) / (top + bottom);
    this.target.copy(center).addScaledVector(side, cx).addScaledVector(up, cy);
    this.look(d.multiplyScalar(cz));
  }

  follow(body) {
    const size = Math.max(this.stage.bodies[body].userData.radius, 0.02 * this.stage.view.radius);
    this.followed = body;
    this.stage.center(body, this.target);
    const half = Math.tan(this.stage.camera.fov * Math.PI / 360) * Math.min(1, this.stage.camera.aspect);
    const away = Math.max(3 * size, 0.35 * this.stage.view.radius) / half;
    this.look(new THREE.Vector3(...this.stage.view.direction).multiplyScalar(away));
  }

  // Put the camera at target + offset.
  look(offset) {
    this.distance = offset.length();
    this.turn = Math.atan2(offset.y, offset.x);
    this.rise = Math.max(-STEEPEST, Math.min(STEEPEST, Math.asin(offset.z / this.distance)));
    this.update();
  }

  update() {
    const {camera, view} = this.stage, flat = Math.cos(this.rise);
    camera.position.set(flat * Math.cos(this.turn), flat * Math.sin(this.turn), Math.sin(this.rise))
      .multiplyScalar(this.distance).add(this.target);
    camera.lookAt(this.target);
    camera.near = Math.max(this.distance / 500, 1e-6);
    camera.far = this.distance * 20 + 20 * view.radius;
    camera.updateProjectionMatrix();
    this.stage.draw();
  }

  // Keep a followed body in the middle.
  keep() {
    if (this.followed === null || this.followed === undefined) { return; }
    this.stage.center(this.followed, this.target);
    this.update();
  }

  drag(event) {
    const before = this.fingers.get(event.pointerId);
    if (!before) { return; }
    const dx = event.clientX - before.clientX, dy = event.clientY - before.clientY;
    const others = [...this.fingers.values()].filter(other => other.pointerId !== event.pointerId);
    this.fingers.set(event.pointerId, event);
    this.touched = true;
    if (others.length) {
      const [other] = others, gap = p => Math.hypot(p.clientX - other.clientX, p.clientY - other.clientY);
      this.pan(dx / 2, dy / 2);
      this.zoom(gap(before) / Math.max(gap(event), 1));
    } else if (event.buttons & 6 || event.shiftKey) {
      this.pan(dx, dy);
    } else {
      this.turn -= 0.006 * dx;
      this.rise = Math.max(-STEEPEST, Math.min(STEEPEST, this.rise + 0.006 * dy));
      this.update();
    }
  }

  pan(dx, dy) {
    const {camera} = this.stage, x = new THREE.Vector3(), y = new THREE.Vector3();
    const perPixel = 2 * this.distance * Math.tan(camera.fov * Math.PI / 360) / this.stage.height;
    camera.matrix.extractBasis(x, y, new THREE.Vector3());
    this.followed = null;
    this.target.addScaledVector(x, -dx * perPixel).addScaledVector(y, dy * perPixel);
    this.update();
  }

  zoom(factor) {
    this.touched = true;
    this.distance = Math.max(1e-3 * this.stage.view.radius, Math.min(100 * this.stage.view.radius,
      this.distance * factor));
    this.update();
  }
}
