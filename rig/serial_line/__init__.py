"""Serial lines whose transmitted bytes can be recorded and replayed."""
