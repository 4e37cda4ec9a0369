"""The application: command line, REST service, pipeline from session to products, demo and benchmarks.

The only place where rig, processing and render meet.
"""
