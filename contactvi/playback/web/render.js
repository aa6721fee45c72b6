// Draw the pictures of `job` one after the other and post them. Runs before the page, to hear of its errors.

const failed = error => fetch("failed", {method: "POST", body: String(error)});
window.addEventListener("error", event => failed(event.message));
window.addEventListener("load", () => draw().catch(failed));

async function draw() {
  document.body.classList.add("bare");
  Object.assign(stage.pane.style, {width: job.width + "px", height: job.height + "px"});
  stage.renderer.domElement.style.visibility = "hidden";  // so that the browser does not draw it, too
  stage.renderer.setPixelRatio(job.ratio);
  if (job.times.length > 1) {  // of a film: a processor without graphics draws soft shadows for half of the time
    stage.renderer.shadowMap.type = THREE.BasicShadowMap;
    stage.sun.shadow.mapSize.set(1024, 1024);
    stage.sun.shadow.dispose();
    stage.sun.shadow.map = null;
  }
  if (job.transparent) { stage.renderer.setClearColor(BACKGROUND, 0); }
  player.pause();
  player.speed = job.speed;
  signs.shown.impacts = job.forces;
  stage.resize();
  orbit.choose(run.camera);
  for (const time of job.times) {
    player.seek(time);
    stage.render();
    await fetch("frame", {method: "POST", body: finished(stage.renderer.domElement)});
  }
}

// The pixels of the picture at its own size, four bytes each, with what is written on it.
const canvas = document.createElement("canvas");
function finished(drawn) {
  Object.assign(canvas, {width: job.width, height: job.height});
  const pen = canvas.getContext("2d", {willReadFrequently: true});
  pen.imageSmoothingQuality = "high";
  pen.drawImage(drawn, 0, 0, job.width, job.height);
  if (job.labels) { labels.drawInto(pen); }
  if (job.forces && signs.source.fullForce !== null && signs.shown.forces) { drawScale(pen); }
  return pen.getImageData(0, 0, job.width, job.height).data;
}

// A scale of the forces: an arrow of a round number of newtons, as long as it is at the target.
function drawScale(pen) {
  const half = Math.tan(stage.camera.fov * Math.PI / 360);
  const perNewton = signs.perNewton * signs.scale * job.height / (2 * orbit.distance * half);  // [pixels/N]
  const newtons = roundBelow(0.16 * job.width / perNewton), length = newtons * perNewton;
  const left = 14, y = job.height - 16, head = 7;
  pen.fillStyle = INK;
  pen.fillRect(left, y - 1.2, length - head, 2.4);
  pen.beginPath();
  pen.moveTo(left + length, y);
  pen.lineTo(left + length - head, y - 3.5);
  pen.lineTo(left + length - head, y + 3.5);
  pen.fill();
  pen.font = '12px "DejaVu Sans", sans-serif';
  pen.textBaseline = "middle";
  pen.fillText(`${newtons} N`, left + length + 6, y);
}

// The largest of 1, 2, 5, 10, 20, ... that is not above a number.
function roundBelow(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return Number(([5, 2, 1].find(digit => digit * power <= most) * power).toPrecision(1));
}
