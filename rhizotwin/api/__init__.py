"""Python interface for import, scans, batches, growth, biomass, benchmarks, export and publication.

`import rhizotwin as rt` provides these functions as ``rt.import_pictures``, ``rt.scan``, ``rt.batch``, ``rt.growth``,
``rt.biomass``, ``rt.benchmark``, ``rt.export`` and ``rt.publish``. Text that the command of the same name prints is
logged.
"""
