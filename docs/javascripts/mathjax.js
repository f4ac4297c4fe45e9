// Formulas arrive as \(...\) and \[...\] inside elements of class "arithmatex".
window.MathJax = {
  tex: { inlineMath: [["\\(", "\\)"]], displayMath: [["\\[", "\\]"]], processEscapes: true, tags: "none" },
  options: { ignoreHtmlClass: ".*", processHtmlClass: "arithmatex", enableMenu: false },
  startup: { pageReady: () => window.MathJax.startup.defaultPageReady().then(markWide) },
};

// Mark formulas within a line that are wider than the block around them, as on a phone.
function markWide() {
  for (const one of document.querySelectorAll("mjx-container:not([display])")) {
    let block = one.parentElement;
    while (!block.clientWidth) block = block.parentElement;  // elements within a line have none
    one.classList.toggle("wide", one.querySelector("svg").getBoundingClientRect().width > block.clientWidth);
  }
}
window.addEventListener("resize", markWide);
