// In a notebook: a view without the player, which that of another cell puts into the page of the notebook, sooner or
// later: cells may be drawn when they are scrolled to.
(function take() {
  let player, why = "is not in the notebook now. It is part of the first cell that shows a view";
  try {
    player = window.parent["@KEY@"];
  } catch {
    why = "is in another cell, and the notebook keeps the outputs of cells apart";
  }
  if (player) {
    for (const text of player) {
      const script = document.createElement("script");
      script.textContent = text;
      document.body.append(script);
    }
    return;
  }
  if (performance.now() > 3000) {
    document.querySelector("#head h1").textContent =
      `The player of this view ${why}. Run this cell again: then it brings its own.`;
  }
  setTimeout(take, 100);
})();
