/* One 3D view for all pairs: a scene is read when its pair is chosen. */
"use strict";

(function () {
  const blank = document.getElementById("space-viewer");
  const pairs = document.getElementById("space-pair");
  const answers = document.getElementById("space-answer");
  if (!blank || !pairs || !answers) return;
  const fresh = blank.cloneNode(true);
  let scene, redraw;

  function showPair() {
    scene = JSON.parse(document.getElementById(pairs.value).textContent);
    const names = Object.keys(scene.answers);
    const kept = names.includes(answers.value) ? answers.value : names[0];
    answers.replaceChildren(...names.map((name) => new Option(name, name, false, name === kept)));
    scene.objects = scene.answers[kept] || [];
    const host = fresh.cloneNode(true); // without the listeners of the scene before
    document.getElementById("space-viewer").replaceWith(host);
    redraw = showScene(host, scene);
  }
  function showAnswer() {
    scene.objects = scene.answers[answers.value] || [];
    redraw();
  }
  pairs.addEventListener("change", showPair);
  answers.addEventListener("change", showAnswer);
  showPair();

  // A link to a pair opens it, wherever the link is
  function openTarget() {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.tagName === "DETAILS") {
      target.open = true;
      target.scrollIntoView();
    }
  }
  window.addEventListener("hashchange", openTarget);
  openTarget();
  for (const link of document.querySelectorAll("a[data-space]"))
    link.addEventListener("click", () => { pairs.value = link.dataset.space; showPair(); });
})();
