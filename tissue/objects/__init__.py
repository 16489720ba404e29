"""What `import tissue` offers: objects that one holds, runs them and shows them. Nothing below
imports it.
"""
