/* Uses the installed library as a stranger would: reads a rig and rectifies it. */
#include <stdio.h>
#include <string.h>

#include <teledimos/core/stereo.h>
#include <teledimos/core/rig.h>

int main(int argc, char **argv)
{
    td_error error = {0};
    td_rig *rig = NULL;
    td_rectification r;
    if (argc != 2 || td_rig_read(&rig, argv[1], &error) != TD_OK) {
        fprintf(stderr, "%s\n", error.message);
        return 1;
    }
    if (td_rectify(&r, &rig->camera[0].camera, &rig->camera[1].camera, &rig->camera[1].camera_from_rig, 0,
                   &error)) {
        fprintf(stderr, "%s\n", error.message);
        return 1;
    }
    printf("baseline %.6f m\n", r.baseline_m);
    td_rig_free(&rig);
    return 0;
}
