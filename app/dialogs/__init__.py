"""The window's dialogs: each gathers what the operator wants and emits it."""
