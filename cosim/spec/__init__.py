"""Scenario and vehicle files as typed, validated models."""
