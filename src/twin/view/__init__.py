"""One run, looked at: live or afterwards in the Rerun viewer, as a page, in sentences."""
