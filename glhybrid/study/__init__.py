"""The comparison study: what each technique costs on a scene and how wrong it is (`study.run.run`)."""
