"""Domain-independent support: errors, files, checked data, settings, processes, pages."""
