/* What the parts of reading a dataset share. */
#ifndef TELEDIMOS_CORE_DATASET_INTERNAL_H
#define TELEDIMOS_CORE_DATASET_INTERNAL_H

#include "core/dataset.h"
#include "core/document.h"

/* Path of a file of the dataset's folder, or else of the images' (`root`); variables replaced. */
td_status td_dataset_parse_near(char **path, const td_field *field, const char *folder, const char *root,
                                td_error *error);

/* dataset_arm.c: `robot` with joints, `points`, `boards`, `sights` of the description `top`; *arm NULL where
 * the robot has no joints. */
td_status td_dataset_parse_arm(td_dataset_arm **arm, const td_field *top, const char *folder,
                               const char *root, td_error *error);
void td_dataset_arm_free(td_dataset_arm **arm);

#endif
