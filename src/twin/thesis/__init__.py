"""The thesis's own tables, computed again; nothing but the command line imports it."""
