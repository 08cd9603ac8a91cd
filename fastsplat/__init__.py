"""FAST-Splat scene service: photos of a place in, a 3D scene out that answers, in plain words, where things are.

In the repository the packages are the folders beside this one (`service/`, `api/`, `workers/`, `cli/`); the links here
give them the names under which they are installed, so that `service` and `api` stay free for everybody else.
"""
