[[ licence ]]
/* The numbers of [[ title ]], made by hexjet export controller ([[ maker ]]).
 *
{% for line in origin %}
 * [[ line ]]
{% endfor %}
 */
#include "[[ n ]].h"

#define R(x) (([[ n ]]_Real)(x))

const [[ n ]]_Parameters [[ n ]]_parameters = {
{% for name, value in values %}
    .[[ name ]] = [[ value|c ]],
{% endfor %}
};
