import bpy

wrinkles = bpy.context.object.wrinkles

wrinkles.plan = "BUDGET"
wrinkles.budget = 36
wrinkles.use_symmetry = True
