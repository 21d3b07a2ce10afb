from .umat import data_statements as data_statements
from .umat import even_law as even_law
from .umat import umat_source as umat_source
from .umat import write_umat as write_umat
