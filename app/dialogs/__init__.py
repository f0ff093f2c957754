"""The window's dialogs: each gathers one wish and emits it."""
