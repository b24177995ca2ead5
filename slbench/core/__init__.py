"""What every other package stands on: errors, validation, files."""
