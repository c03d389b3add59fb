// The page that describes the interface, by Swagger UI, whose controls without a name get one.
"use strict";

/** @type {any} */ (window).SwaggerUIBundle({ url: "openapi.json", dom_id: "#swagger", deepLinking: false });

function nameControls() {
  for (const one of document.querySelectorAll("[data-param-name] :is(input, select, textarea)")) {
    one.setAttribute("aria-label", one.closest("[data-param-name]")?.getAttribute("data-param-name") ?? "");
  }
  for (const one of document.querySelectorAll(".body-param textarea")) one.setAttribute("aria-label", "Body");
  for (const one of document.querySelectorAll(".close-modal")) one.setAttribute("aria-label", "Close");
  for (const one of document.querySelectorAll("table[role=region]")) one.setAttribute("aria-label", one.id);
}

new MutationObserver(nameControls).observe(document.body, { childList: true, subtree: true });
