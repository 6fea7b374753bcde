"""Masks: what moves by itself, found in the links or given by the user."""
