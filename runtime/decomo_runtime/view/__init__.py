"""The page on which one clicks a pixel and sees its whole path: `decomo-view`.

`site.py` puts the page, a model and its clip into one folder, `server.py` serves such a folder on this machine alone.
The page itself, `page/`, is built from `runtime/web` and runs the model in the browser.
"""
