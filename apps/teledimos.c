/* The driver: `teledimos COMMAND …` runs libexec/teledimos/COMMAND, so that each command loads only the
 * libraries it uses, and --version and --help none. */
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

static const struct {
    const char *name, *summary;
} commands[] = {
    {"calibrate", "calibrate cameras and their relative poses from images of a target"},
    {"capture", "take images from cameras, videos or folders into a dataset"},
    {"check", "check a rig against new images, without solving for it"},
    {"compare", "compare two rigs: difference over the images, with its significance"},
    {"hand-eye", "where the cameras sit on a robot, with how far to trust it"},
    {"vehicle", "where the cameras sit on a machine, and what that is worth at the bucket's tip"},
    {"machine", "the simulated machine as a process of its own, and orders to it"},
    {"match", "points of a stereo pair in metres, guided or automatic"},
    {"reconstruct", "a dataset's stereo pairs into an elevation map"},
    {"measure", "cut and fill between two maps with their error, profiles, slopes"},
    {"rectify", "turn stereo pairs so that rows match rows"},
    {"render", "draw what a rig's cameras see of a scene"},
    {"rehearse", "the closed loop: look, plan, simulate ahead, execute, look again"},
    {"simulate", "a machine moved by given commands, or doing a task: motion, forces, sag"},
    {"panel", "a session in real time, seen and led over the network (Foxglove)"},
    {"workbench", "pictures worked on for another program: what the panel runs for its views of them"},
    {"servo", "bring the bucket where tags say, by what a camera shows"},
    {"convert", "turn a rig into the files of another tool, or those into a rig"},
    {"target", "print a calibration target at true scale"},
};
enum { COMMAND_COUNT = sizeof commands / sizeof *commands };

static void print_help(void)
{
    printf("teledimos — calibrate, reconstruct, rehearse: for machines that work at a distance\n\n"
           "Usage: teledimos COMMAND [arguments]\n\nCommands:\n");
    for (int i = 0; i < COMMAND_COUNT; i++) printf("  %-12s %s\n", commands[i].name, commands[i].summary);
    printf("\n  teledimos COMMAND --help   explains a command, with examples\n"
           "  teledimos --version        prints the version\n"
           "  teledimos --completion     prints a completion script for bash: eval \"$(teledimos "
           "--completion)\"\n");
}

static void print_completion(void)
{
    printf("_teledimos() {\n"
           "    local word=\"${COMP_WORDS[COMP_CWORD]}\"\n"
           "    if [ \"$COMP_CWORD\" -eq 1 ]; then\n"
           "        COMPREPLY=($(compgen -W \"");
    for (int i = 0; i < COMMAND_COUNT; i++) printf("%s ", commands[i].name);
    printf("--help --version\" -- \"$word\"))\n"
           "    elif [ \"${word#-}\" != \"$word\" ]; then\n"
           "        COMPREPLY=($(compgen -W \"$(teledimos \"${COMP_WORDS[1]}\" --complete 2>/dev/null)\" -- "
           "\"$word\"))\n"
           "    else\n"
           "        COMPREPLY=($(compgen -f -- \"$word\"))\n"
           "    fi\n"
           "}\n"
           "complete -o filenames -F _teledimos teledimos\n");
}

/* PREFIX/bin/teledimos to PREFIX/libexec/teledimos/NAME. */
static int find_command(char *path, size_t size, const char *name)
{
    char self[PATH_MAX];
    ssize_t length = readlink("/proc/self/exe", self, sizeof self - 1);
    if (length <= 0) return 0;
    self[length] = 0;
    for (int i = 0; i < 2; i++) {
        char *slash = strrchr(self, '/');
        if (!slash) return 0;
        *slash = 0;
    }
    return snprintf(path, size, "%s/libexec/teledimos/%s", self, name) < (int)size;
}

/* Whether mpirun, or Slurm's srun, has started several of us: then a command's MPI program is run. */
static int is_one_of_many(void)
{
    static const char *const sizes[] = {"OMPI_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS"};
    for (size_t i = 0; i < sizeof sizes / sizeof *sizes; i++) {
        const char *size = getenv(sizes[i]);
        if (size && atoi(size) > 1) return 1;
    }
    return 0;
}

int main(int argc, char **argv)
{
    if (argc < 2 || strcmp(argv[1], "--help") == 0 || strcmp(argv[1], "-h") == 0 ||
        strcmp(argv[1], "help") == 0) {
        print_help();
        return argc < 2 ? 2 : 0;
    }
    if (strcmp(argv[1], "--version") == 0) {
        printf("teledimos %s\n", TD_VERSION);
        return 0;
    }
    if (strcmp(argv[1], "--completion") == 0) {
        print_completion();
        return 0;
    }
    for (int i = 0; i < COMMAND_COUNT; i++) {
        if (strcmp(argv[1], commands[i].name) != 0) continue;
        char path[PATH_MAX];
        const int many = is_one_of_many() && strcmp(argv[1], "reconstruct") == 0;
        if (!find_command(path, sizeof path, many ? "reconstruct-mpi" : argv[1])) {
            fprintf(stderr, "teledimos: the place of the program cannot be found\n");
            return 1;
        }
        execv(path, argv + 1);
        fprintf(stderr, "teledimos: %s cannot be run: %s; is the installation complete%s?\n", path,
                strerror(errno), many ? ", and was it built with Open MPI (libopenmpi-dev)" : "");
        return 1;
    }
    fprintf(stderr, "teledimos: there is no command '%s' (see teledimos --help)\n", argv[1]);
    return 2;
}
