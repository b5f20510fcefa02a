// Renders the formulas of a page with KaTeX; without it their LaTeX stays.
if (window.katex) {
  for (const element of document.querySelectorAll('span.formula')) {
    const displayMode = element.classList.contains('display');
    katex.render(element.textContent, element, {displayMode, throwOnError: false});
  }
}
