"""A static page that describes the HTTP interface (OpenAPI): requests, fields and answers."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from html import escape
from typing import Any

Plain = Mapping[str, Any]


def page(described: Plain) -> str:
    """Return the page, from its title element on.

    Parameters
    ----------
    described : mapping
        OpenAPI 3.1 description, as FastAPI generates it.
    """
    schemas = described["components"]["schemas"]
    parts = [
        f"<h2><code>{method.upper()} {escape(path)}</code></h2>{''.join(_request(request, schemas))}"
        for path, methods in described["paths"].items()
        for method, request in methods.items()
    ]
    title = escape(described["info"]["title"])
    return (
        f"<title>{title}: HTTP interface</title></head><body><main>"
        f"<h1>{title}</h1><p>{escape(described['info'].get('summary', ''))}</p>"
        '<p>Send the token, which is the part of a link after #, as <code>Authorization: Bearer TOKEN</code>. For '
        f'programs: <a href="/openapi.json">openapi.json</a>.</p>{"".join(parts)}</main></body></html>'
    )  # fmt: skip


def _request(request: Plain, schemas: Plain) -> Iterator[str]:
    yield f"<p>{escape(request.get('description', ''))}</p>"
    fields = [
        f"<li><code>{escape(one['name'])}</code> ({one['in']}): {_type(one['schema'])}</li>"
        for one in request.get("parameters", ())
    ]
    for content in request.get("requestBody", {}).get("content", {}).values():
        fields += _fields(content["schema"], schemas)
    if fields:
        yield f"<h3>Request</h3><ul>{''.join(fields)}</ul>"
    yield "<h3>Responses</h3><ul>"
    for code, answer in sorted(request["responses"].items()):
        models = [content.get("schema", {}) for content in answer.get("content", {}).values()]
        said = answer.get("description", "")
        if code == "200":
            said = ", ".join(field for model in models for field in _names(model, schemas)) or said
        yield f"<li>{code}: {escape(said)}</li>"
    yield "</ul>"


def _resolved(schema: Plain, schemas: Plain) -> Plain:
    for one in (schema, *schema.get("anyOf", ())):
        if "$ref" in one:
            found: Plain = schemas[one["$ref"].rsplit("/", 1)[1]]
            return found
    return schema


def _names(schema: Plain, schemas: Plain) -> list[str]:
    return list(_resolved(schema, schemas).get("properties", ()))


def _fields(schema: Plain, schemas: Plain) -> list[str]:
    model = _resolved(schema, schemas)
    return [
        f"<li><code>{escape(name)}</code>{'' if name in model.get('required', ()) else ', optional'}: {_type(field)} "
        f"{escape(field.get('description', ''))}</li>"
        for name, field in model.get("properties", {}).items()
    ]


def _type(schema: Plain) -> str:
    kinds = [one.get("type", "object") for one in schema.get("anyOf", (schema,))]
    bounds = {name: schema[name] for name in ("minLength", "maxLength", "minimum", "maximum") if name in schema}
    return escape(" or ".join(kinds) + (f" {json.dumps(bounds)}" if bounds else ""))
