"""The table `[setting]` of TOML files. It needs msgspec, which only extras of the package install."""

from __future__ import annotations

from assist.texts.typed_toml import AnyTable, WholeOrTables, partial_of

from .settings import Setting

SettingTable = partial_of(
    Setting,
    trust=str | AnyTable,
    believed_trust=str | AnyTable,
    observation=AnyTable,
    c_ask=float,
    robots=WholeOrTables,
)
"""Any of a setting's fields, with the types that they have in TOML."""
