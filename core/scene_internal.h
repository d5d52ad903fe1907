/* Parts of the scene's reader. `folder` NULL: only check. */
#ifndef TELEDIMOS_CORE_SCENE_INTERNAL_H
#define TELEDIMOS_CORE_SCENE_INTERNAL_H

#include "core/document.h"
#include "core/scene.h"

/* The path of a file that a scene names: beside it unless it is absolute; to be freed with free(). */
td_status td_scene_path(char **path, const td_field *field, const char *folder, td_error *error);
td_status td_scene_name(char name[TD_NAME_SIZE], const td_field *parent, td_error *error);
/* Optional numbers keep their value when they are missing. */
td_status td_scene_real(double *value, const td_field *parent, const char *key, double low, double high,
                        td_error *error);
td_status td_scene_int(int *value, const td_field *parent, const char *key, int low, int high,
                       td_error *error);
td_status td_scene_surface(td_surface *surface, const td_field *field, td_error *error);

/* scene_ground.c: from {map: …} or {generate: …}. */
td_status td_scene_ground_parse(td_elevation **map, const td_field *field, const char *folder,
                                td_error *error);

/* scene_bodies.c */
td_status td_scene_solids_parse(td_scene *scene, const td_field *field, const char *folder, td_error *error);
td_status td_scene_pictures_parse(td_scene *scene, const td_field *field, const char *folder,
                                  td_error *error);

#endif
