"""Datasets: many scenes drawn from one template."""
