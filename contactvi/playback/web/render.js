// Draw the pictures of `job` one after the other and post them: nothing for one in which nothing has moved since the one
// before. Runs before the page, to hear of its errors.

const failed = error => fetch("failed", {method: "POST", body: String(error)});
window.addEventListener("error", event => failed(event.message));
window.addEventListener("load", () => draw().catch(failed));

async function draw() {
  document.body.classList.add("bare");
  Object.assign(stage.pane.style, {width: job.width + "px", height: job.height + "px"});
  stage.renderer.domElement.style.visibility = "hidden";  // so that the browser does not draw it, too
  stage.renderer.setPixelRatio(job.ratio);
  const film = job.times.length > 1;
  if (film) {  // a processor without graphics draws soft shadows for half of the time
    stage.renderer.shadowMap.type = THREE.BasicShadowMap;
    stage.sun.shadow.mapSize.set(1024, 1024);
    stage.sun.shadow.dispose();
    stage.sun.shadow.map = null;
  }
  if (job.transparent) { stage.renderer.setClearColor(BACKGROUND, 0); }
  if (job.ground !== "drawn") { stage.hideGround(job.ground === "shadows"); }
  player.pause();
  signs.apart = () => job.times.length === 1;
  player.speed = job.speed;
  signs.shown.impacts = job.forces;
  player.tick = () => {};  // or what stands still would be drawn again and again
  stage.resize();
  player.seek(job.times[0]);
  orbit.margins = () => [0, hasScales(film) ? Math.max(0, SCALE_HEIGHT - 0.025 * job.height) : 0];
  orbit.choose(run.camera);
  const post = pixels => fetch("frame", {method: "POST", body: pixels});
  if (!film || !stage.renderer.capabilities.isWebGL2) {
    for (const time of job.times) {
      player.seek(time);
      stage.render();
      await post(finished());
    }
    return;
  }
  // A frame is drawn while the one before is read, and that one while the one before it is on its way.
  const copies = [new Copy(), new Copy()], {renderer} = stage;
  const smoother = isSoftware(renderer.getContext()) ? new Smoother(renderer, job.width, job.height) : null;
  let read = null, sent = Promise.resolve();
  const send = async copy => {
    const pixels = copy.drawn ? await copy.pixels() : "";
    await sent;
    sent = post(pixels);
  };
  for (const [k, time] of job.times.entries()) {
    const copy = copies[k % 2];
    player.seek(time);
    copy.drawn = differs(appearance());
    if (copy.drawn) {
      copy.begin(smoother ? smoother.draw(() => stage.render()) : drawnOnCanvas());
    }
    if (read) { await send(read); }
    read = copy;
  }
  await send(read);
  await sent;
}

// Draw on the canvas of the page: that is the framebuffer which WebGL calls null.
function drawnOnCanvas() {
  stage.render();
  return null;
}

// What the stage has drawn, on its way into the memory of the page, and what is written on it.
class Copy {
  constructor() {
    const {width, height} = job, gl = stage.renderer.getContext();
    Object.assign(this, {gl, buffer: gl.createBuffer(), rows: new Uint8Array(4 * width * height),
      picture: new ImageData(width, height), canvas: newCanvas(), writing: newCanvas()});
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.bufferData(gl.PIXEL_PACK_BUFFER, this.rows.length, gl.STREAM_READ);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
  }

  begin(framebuffer) {
    const {gl, writing} = this;
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, framebuffer);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.readPixels(0, 0, job.width, job.height, gl.RGBA, gl.UNSIGNED_BYTE, 0);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    gl.bindFramebuffer(gl.READ_FRAMEBUFFER, null);
    this.done = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const pen = penOf(writing);
    pen.clearRect(0, 0, job.width, job.height);
    write(pen);
  }

  async pixels() {
    const {gl, rows, picture} = this, size = 4 * job.width;
    while (gl.clientWaitSync(this.done, 0, 0) === gl.TIMEOUT_EXPIRED) { await new Promise(go => setTimeout(go, 1)); }
    gl.deleteSync(this.done);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, this.buffer);
    gl.getBufferSubData(gl.PIXEL_PACK_BUFFER, 0, rows);
    gl.bindBuffer(gl.PIXEL_PACK_BUFFER, null);
    for (let row = 0; row < job.height; ++row) {  // WebGL has the lowest one first
      picture.data.set(rows.subarray(size * (job.height - 1 - row), size * (job.height - row)), size * row);
    }
    if (!job.labels && !job.forces) { return picture.data; }
    const pen = penOf(this.canvas);
    pen.putImageData(picture, 0, 0);
    pen.drawImage(this.writing, 0, 0);
    return pen.getImageData(0, 0, job.width, job.height).data;
  }
}

// Whether the picture is not the one that was drawn last: something in it has moved by a fiftieth of a pixel.
let drawnLast = {numbers: [], colors: []};
function differs(now) {
  const least = 0.02 / pixelsPerMetre(), near = (x, k) => Math.abs(x - drawnLast.numbers[k]) < least;
  const same = now.numbers.length === drawnLast.numbers.length && now.numbers.every(near) &&
    now.colors.join() === drawnLast.colors.join();
  if (!same) { drawnLast = now; }
  return !same;
}

// What a picture depends on: places and lengths [m], of three points of each body and of the camera, of lines and signs,
// and the colours of signs.
function appearance() {
  const numbers = [], point = new THREE.Vector3(), reach = stage.view.radius;
  for (const {position, quaternion} of [stage.camera, ...stage.bodies]) {
    numbers.push(...position.toArray());
    for (const axis of [0, 2]) {
      numbers.push(...point.set(0, 0, 0).setComponent(axis, reach).applyQuaternion(quaternion).toArray());
    }
  }
  for (const {ends} of stage.lines) { numbers.push(...ends.flatMap(end => end.toArray())); }
  const arrows = [...signs.forces.places, ...signs.impacts.places];
  for (const [place, direction, length] of arrows) {
    numbers.push(...place.toArray(), ...point.copy(direction).multiplyScalar(length).toArray());
  }
  return {numbers: [...numbers, ...signs.dots.places], colors: [...arrows.map(arrow => arrow[3]), ...signs.dots.colors]};
}

// Pixels of a metre at the target.
function pixelsPerMetre() { return job.height / (2 * orbit.distance * Math.tan(stage.camera.fov * Math.PI / 360)); }

function newCanvas() { return Object.assign(document.createElement("canvas"), {width: job.width, height: job.height}); }

function penOf(canvas) { return canvas.getContext("2d", {willReadFrequently: true}); }

// The pixels of the picture at its own size, four bytes each, with what is written on it.
function finished() {
  const pen = penOf(newCanvas());
  pen.imageSmoothingQuality = "high";
  pen.drawImage(stage.renderer.domElement, 0, 0, job.width, job.height);
  write(pen);
  return pen.getImageData(0, 0, job.width, job.height).data;
}

// Write names and scales on the picture.
function write(pen) {
  if (job.labels) {
    const numbers = job.forces && job.times.length === 1 ? placedNumbers() : [];
    labels.drawInto(pen, [...numbers.filter(box => box), ...numbers.length ? signs.boxes() : []]);
    drawNumbers(pen, numbers);
  }
  if (job.forces) { drawScales(pen); }
}

const SCALE_HEIGHT = 28;  // [px] below what is drawn, of which the camera leaves a fortieth of the height free anyway

// Whether there are scales in the picture, or in one of those of a film.
function hasScales(film) {
  const impulses = film ? source.events.strongest > 0 : signs.struck.length > 0;
  return job.forces && (source.fullForce !== null || impulses);
}

// Scales of forces, and of impulses where there are some: arrows of round numbers, as long as they are at the target.
function drawScales(pen) {
  const {source, scale} = signs, perMetre = pixelsPerMetre();
  let left = 14;
  if (source.fullForce !== null && signs.shown.forces) {
    const given = source.forceScale ? ` (${Number(source.forceScale.toPrecision(6))} N/m)` : "";
    left = drawScale(pen, left, signs.perNewton * scale * perMetre, INK, newtons => `${newtons} N${given}`);
  }
  if (signs.shown.impacts && signs.struck.length) {
    drawScale(pen, left, signs.perNewtonSecond * perMetre, css(IMPACT_COLOR), impulse => `${impulse} N s`);
  }
}

// An arrow with words beside it, from `left` [px] on; returns where the words end.
function drawScale(pen, left, perUnit, color, words) {
  const amount = roundBelow(0.16 * job.width / perUnit), length = amount * perUnit, y = job.height - 16, head = 7;
  pen.fillStyle = color;
  pen.fillRect(left, y - 1.2, length - head, 2.4);
  pen.beginPath();
  pen.moveTo(left + length, y);
  pen.lineTo(left + length - head, y - 3.5);
  pen.lineTo(left + length - head, y + 3.5);
  pen.fill();
  pen.font = '12px "DejaVu Sans", sans-serif';
  pen.textBaseline = "middle";
  pen.fillStyle = INK;
  pen.fillText(words(amount), left + length + 6, y);
  return left + length + 6 + pen.measureText(words(amount)).width + 22;
}

// Boxes for the numbers of several impulses in the order of time, behind their arrows; null where there is no room.
function placedNumbers() {
  if (signs.struck.length < 2) { return []; }
  const point = new THREE.Vector3();
  const boxes = signs.struck.map(({direction}, k) => {
    point.copy(signs.starts[k]).project(stage.camera);
    const [x, y] = [(0.5 + 0.5 * point.x) * job.width, (0.5 - 0.5 * point.y) * job.height];
    point.copy(signs.starts[k]).addScaledVector(direction, 0.1 * stage.view.size).project(stage.camera);
    const [u, v] = [(0.5 + 0.5 * point.x) * job.width - x, (0.5 - 0.5 * point.y) * job.height - y];
    const size = Math.hypot(u, v) || 1;
    return {x: x - 8 * u / size, y: y - 8 * v / size, width: 6 + 6 * String(k + 1).length, height: 11, order: k};
  });
  return declutter(boxes, job.width, job.height);
}

function drawNumbers(pen, boxes) {
  pen.font = 'bold 10px "DejaVu Sans", sans-serif';
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  boxes.forEach((box, k) => {
    if (!box) { return; }
    pen.strokeStyle = "#ffffff";
    pen.lineWidth = 2.5;
    pen.strokeText(k + 1, box.x, box.y);
    pen.fillStyle = css(IMPACT_COLOR);
    pen.fillText(k + 1, box.x, box.y);
  });
  pen.textAlign = "start";
}

// The largest of 1, 2, 5, 10, 20, ... that is not above a number.
function roundBelow(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return Number(([5, 2, 1].find(digit => digit * power <= most) * power).toPrecision(1));
}
