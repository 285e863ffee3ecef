"""Answers: densities, numbers and curves with their errors, certificates, methods and routes."""
