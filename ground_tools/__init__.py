"""Desk tools: inspection, conformance checks, campaigns."""
