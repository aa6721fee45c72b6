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
    const picture = await new Promise(done => stage.renderer.domElement.toBlob(done));
    await fetch("frame", {method: "POST", body: picture});
  }
}
