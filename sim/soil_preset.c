#include "sim/soil_preset.h"

#include <math.h>
#include <string.h>

#include "core/document.h"

static const char KIND[] = "soil 1";
static const double DEGREE = 0.017453292519943295;

enum { DENSITY, SWELL, COHESION, ADHESION, FRICTION, TOOL_FRICTION, REPOSE, FIGURES };

/* Between these bounds lies every soil a bucket digs: from peat to dense gravel, from dry sand to stiff clay.
 */
static const struct {
    const char *key;
    double low, high;
} figures[FIGURES] = {
    [DENSITY] = {"density_kg_m3", 500, 3000}, [SWELL] = {"swell", 1, 2},
    [COHESION] = {"cohesion_pa", 0, 1e6},     [ADHESION] = {"adhesion_pa", 0, 1e6},
    [FRICTION] = {"friction_deg", 1, 60},     [TOOL_FRICTION] = {"tool_friction", 0, 1.2},
    [REPOSE] = {"repose_deg", 5, 60},
};

static td_status check_together(const double value[FIGURES], const char *name, td_error *error)
{
    if (value[TOOL_FRICTION] > tan(value[FRICTION] * DEGREE) * (1 + 1e-9))
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: tool_friction: %g is above the soil's own, tan %g deg = %g: it would slip in "
                       "itself first; give at most that",
                       name, value[TOOL_FRICTION], value[FRICTION], tan(value[FRICTION] * DEGREE));
    if (value[ADHESION] > value[COHESION])
        return td_fail(error, TD_ERROR_ARGUMENT,
                       "%s: adhesion_pa: %g is above cohesion_pa, %g: the soil would tear in itself first; "
                       "give at most that",
                       name, value[ADHESION], value[COHESION]);
    return TD_OK;
}

td_status td_soil_preset_check(const td_soil_preset *preset, td_error *error)
{
    if (!preset) return td_fail(error, TD_ERROR_ARGUMENT, "soil: no preset was given; read one first");
    const double value[FIGURES] = {
        preset->density_kg_m3,         preset->swell,
        preset->cohesion_pa,           preset->adhesion_pa,
        preset->friction_rad / DEGREE, tan(preset->tool_friction_rad),
        preset->repose_rad / DEGREE,
    };
    const char *name = preset->name[0] ? preset->name : "soil";
    for (int i = 0; i < FIGURES; i++)
        if (!(value[i] >= figures[i].low * (1 - 1e-12) && value[i] <= figures[i].high * (1 + 1e-12)))
            return td_fail(error, TD_ERROR_ARGUMENT, "%s: %s: must be %g to %g, not %g", name, figures[i].key,
                           figures[i].low, figures[i].high, value[i]);
    return check_together(value, name, error);
}

static td_status parse_figure(double *value, const td_field *parent, int figure, td_error *error)
{
    static const char *const keys[] = {"value", "source", "range", NULL};
    const td_field field = td_field_get(parent, figures[figure].key);
    if (!field.value) return td_field_fail(&field, error, "is missing; give {value: …, source: …}");
    TD_TRY(td_field_check_keys(&field, keys, error));
    const td_field at = td_field_get(&field, "value"), source = td_field_get(&field, "source");
    const td_field range = td_field_get(&field, "range");
    const char *text = NULL;
    TD_TRY(td_field_real(value, &at, figures[figure].low, figures[figure].high, error));
    TD_TRY(td_field_string(&text, &source, error));
    if (!*text) return td_field_fail(&source, error, "is empty; say where the figure comes from");
    if (!range.value) return TD_OK;
    double limit[2];
    TD_TRY(td_field_reals(limit, 2, &range, figures[figure].low, figures[figure].high, error));
    if (*value < limit[0] || *value > limit[1])
        return td_field_fail(&at, error, "%g is outside its own range, %g to %g", *value, limit[0], limit[1]);
    return TD_OK;
}

static td_status parse_head(td_soil_preset *preset, const td_field *root, td_error *error)
{
    static const char *const keys[] = {"teledimos", "name", "about", "figures", NULL};
    const td_field kind = td_field_get(root, "teledimos"), name = td_field_get(root, "name");
    const td_field about = td_field_get(root, "about");
    const char *text = NULL;
    if (!kind.value)
        return td_field_fail(root, error, "is no soil: 'teledimos: %s' is missing at its beginning", KIND);
    TD_TRY(td_field_string(&text, &kind, error));
    if (strcmp(text, KIND) != 0) return td_field_fail(&kind, error, "must be '%s'", KIND);
    TD_TRY(td_field_check_keys(root, keys, error));
    if (about.value) TD_TRY(td_field_string(&text, &about, error));
    TD_TRY(td_field_string(&text, &name, error));
    const size_t length = strlen(text);
    if (length < 1 || length >= TD_NAME_SIZE ||
        strspn(text, "abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789-_") != length)
        return td_field_fail(&name, error, "must be 1 to %d letters, digits, - and _", TD_NAME_SIZE - 1);
    memcpy(preset->name, text, length + 1);
    return TD_OK;
}

static td_status parse_root(td_soil_preset *preset, const td_field *root, td_error *error)
{
    double value[FIGURES];
    const char *keys[FIGURES + 1] = {NULL};
    const td_field field = td_field_get(root, "figures");
    TD_TRY(parse_head(preset, root, error));
    for (int i = 0; i < FIGURES; i++) keys[i] = figures[i].key;
    if (!field.value) return td_field_fail(&field, error, "is missing");
    TD_TRY(td_field_check_keys(&field, keys, error));
    for (int i = 0; i < FIGURES; i++) TD_TRY(parse_figure(value + i, &field, i, error));
    TD_TRY(check_together(value, root->name, error));
    preset->density_kg_m3 = value[DENSITY];
    preset->swell = value[SWELL];
    preset->cohesion_pa = value[COHESION];
    preset->adhesion_pa = value[ADHESION];
    preset->friction_rad = value[FRICTION] * DEGREE;
    preset->tool_friction_rad = atan(value[TOOL_FRICTION]);
    preset->repose_rad = value[REPOSE] * DEGREE;
    return TD_OK;
}

static td_status take_root(td_soil_preset *preset, json_t *root, const char *name, td_error *error)
{
    const td_field field = {NULL, name, root};
    *preset = (td_soil_preset){0};
    const td_status status = parse_root(preset, &field, error);
    json_decref(root);
    return status;
}

td_status td_soil_preset_read(td_soil_preset *preset, const char *path, td_error *error)
{
    json_t *root = NULL;
    TD_TRY(td_document_read(&root, path, error));
    return take_root(preset, root, path, error);
}

td_status td_soil_preset_parse(td_soil_preset *preset, const char *text, size_t size, const char *name,
                               td_error *error)
{
    json_t *root = NULL;
    TD_TRY(td_document_parse(&root, text, size, name, error));
    return take_root(preset, root, name, error);
}
