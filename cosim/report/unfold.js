// Opens the folded part of the page that a link leads to.
(() => {
  "use strict";

  function unfold() {
    const target = document.getElementById(decodeURIComponent(location.hash.slice(1)));
    if (target && target.tagName === "DETAILS") target.open = true;
  }

  addEventListener("hashchange", unfold);
  unfold();
})();
