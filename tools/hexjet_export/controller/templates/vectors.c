[[ licence ]]
/* See [[ n ]]_vectors.h. */
#include "[[ n ]]_vectors.h"

const double [[ n ]]_start[ [[- start|length ]]] = {[[ start|join(", ") ]]};

const double [[ n ]]_vectors[ [[- N ]]_STEPS][ [[- N ]]_COLUMNS] = {
{% for row in rows %}
    {[[ row|join(", ") ]]},
{% endfor %}
};
