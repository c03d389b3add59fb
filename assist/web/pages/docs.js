// The page that describes the interface, by Swagger UI.
"use strict";

/** @type {any} */ (window).SwaggerUIBundle({ url: "openapi.json", dom_id: "#swagger", deepLinking: false });
