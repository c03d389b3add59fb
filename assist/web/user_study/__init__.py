"""User studies over HTTP."""
