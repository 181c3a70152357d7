"""Manual corrections of a result: log, corrected shape, volume and traits."""
