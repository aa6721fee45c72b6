// Draw the pictures of `job` one after the other and post them. Runs before the page, to hear of its errors.

const failed = error => fetch("failed", {method: "POST", body: String(error)});
window.addEventListener("error", event => failed(event.message));
window.addEventListener("load", () => draw().catch(failed));

async function draw() {
  document.body.classList.add("bare");
  Object.assign(stage.pane.style, {width: job.width + "px", height: job.height + "px"});
  player.pause();
  player.speed = job.speed;
  signs.shown.impacts = job.forces;
  stage.resize();
  orbit.choose(run.camera);
  for (const time of job.times) {
    player.seek(time);
    stage.render();
    const picture = await new Promise(done => signed(stage.renderer.domElement).toBlob(done));
    await fetch("frame", {method: "POST", body: picture});
  }
}

// The picture with a scale of the forces, where the run has some: an arrow of a round number of newtons.
function signed(drawn) {
  if (!job.forces || signs.source.fullForce === null || !signs.shown.forces) { return drawn; }
  const half = Math.tan(stage.camera.fov * Math.PI / 360), ratio = drawn.height / job.height;
  const perNewton = signs.perNewton * signs.scale * drawn.height / (2 * orbit.distance * half);  // [pixels/N] at the target
  const newtons = roundBelow(0.16 * drawn.width / perNewton), length = newtons * perNewton;
  const canvas = Object.assign(document.createElement("canvas"), {width: drawn.width, height: drawn.height});
  const pen = canvas.getContext("2d"), left = 14 * ratio, y = drawn.height - 16 * ratio, head = 7 * ratio;
  pen.drawImage(drawn, 0, 0);
  pen.fillStyle = "#1e4fbf";
  pen.fillRect(left, y - 1.2 * ratio, length - head, 2.4 * ratio);
  pen.beginPath();
  pen.moveTo(left + length, y);
  pen.lineTo(left + length - head, y - 3.5 * ratio);
  pen.lineTo(left + length - head, y + 3.5 * ratio);
  pen.fill();
  pen.fillStyle = "#1d2733";
  pen.font = `${12 * ratio}px "DejaVu Sans", sans-serif`;
  pen.textBaseline = "middle";
  pen.fillText(`${newtons} N`, left + length + 6 * ratio, y);
  return canvas;
}

// The largest of 1, 2, 5, 10, 20, ... that is not above a number.
function roundBelow(most) {
  const power = 10 ** Math.floor(Math.log10(most));
  return Number(([5, 2, 1].find(digit => digit * power <= most) * power).toPrecision(1));
}
