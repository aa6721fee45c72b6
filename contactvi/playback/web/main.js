// The page of a recorded run, or of a simulator that runs.

const run = JSON.parse(element("run").textContent);
const outline = unpack(run.view.outline);
run.view.outline = Array.from({length: outline.length / 3}, (_, k) => Array.from(outline.subarray(3 * k, 3 * k + 3)));
const source = run.live ? new LiveSource(run) : new Recording(run);
let stage;
try {
  stage = new Stage(element("view"), run.view, source);
} catch (error) {
  document.querySelector("#head h1").textContent = "This page needs WebGL, which the browser does not offer here.";
  throw error;
}
const orbit = new Orbit(stage, run.camera);
const signs = new Signs(stage, source);
const labels = new Labels(stage);
const player = new (run.live ? LivePlayer : Player)(stage, orbit, signs, source);
signs.apart = () => !player.playing;
player.seek(source.start);
const panels = new Panels(player, run);
orbit.choose(run.camera);
player.seek(source.start);
if (run.play) { player.play(); }
if (run.live) { connect(player, panels); }
requestAnimationFrame(function tick(now) {
  requestAnimationFrame(tick);
  player.tick(now);
});
