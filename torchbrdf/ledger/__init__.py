"""What accuracy costs: every registered law, each of its methods beside the others, errors against exact arithmetic and times.

Run by ``python -m torchbrdf.ledger``. A law joins by a line in ``registry.LAWS``; its methods need nothing else. Nothing of the
package imports this; it takes gmpy2, matplotlib and tqdm: ``pip install 'torchbrdf[bench]'``.
"""
