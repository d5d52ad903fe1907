/* Folders of other makers, told as the three texts that a dataset of ours would hold. */
#ifndef TELEDIMOS_CORE_DATASET_LAYOUT_INTERNAL_H
#define TELEDIMOS_CORE_DATASET_LAYOUT_INTERNAL_H

#include "core/dataset.h"
#include "core/text_internal.h"

typedef struct td_dataset_layout {
    char *yaml, *table, *rig; /* dataset.yaml, frames.csv, rig.yaml; rig NULL: the folder does not tell it */
} td_dataset_layout;

/* EuRoC: mav0/cam0/{sensor.yaml, data.csv, data/}, cam1 … (or the folder mav0 itself); the body's poses from
 * mav0/state_groundtruth_estimate0/data.csv, or else from a table `timestamp(s) tx ty tz qx qy qz qw` (a .txt
 * beside mav0). Poses are interpolated at the images' times; images farther than 0.1 s from one have none.
 * Rows of data.csv neither of whose images is there are left out. */
bool td_dataset_is_euroc(const char *folder);
td_status td_dataset_euroc(td_dataset_layout *layout, const char *folder, td_error *error);

/* Middlebury: a rectified pair, im0 and im1 (2014), im2 and im6 (2003) or view1 and view5 (2005, 2006), .png
 * or .ppm, and, of 2014, calib.txt. */
bool td_dataset_is_middlebury(const char *folder);
td_status td_dataset_middlebury(td_dataset_layout *layout, const char *folder, td_error *error);

/* A name for the dataset: the last part of the folder's path, what may not stand in one replaced. */
void td_dataset_layout_name(char name[TD_NAME_SIZE], const char *folder);
/* "folder/name" is a file. */
bool td_dataset_has_file(const char *folder, const char *name);
void td_dataset_layout_free(td_dataset_layout *layout);

#endif
