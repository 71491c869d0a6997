"""What knows nothing of a ball: errors, files, checked data, settings, processes, pages."""
