[[ licence ]]
/* The numbers of [[ title ]], made by hexjet export controller ([[ maker ]]).
 *
{% for line in origin %}
 * [[ line ]]
{% endfor %}
 */
#include "[[ n ]].h"

#define R(x) (([[ n ]]_Real)(x))
{% if f.allocation.kind == "effectiveness" %}
#ifdef [[ N ]]_FLOAT
#define GIVEN 1e-5f /* of a scaled row: what is missing less is rounding */
#else
#define GIVEN 1e-10
#endif
{% endif %}

const [[ n ]]_Parameters [[ n ]]_parameters = {
{% for name, value in values %}
    .[[ name ]] = [[ value|c ]],
{% endfor %}
};
