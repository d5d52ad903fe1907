# What both commands need: packages of Debian 12, installed when missing. Sourced, with the list of packages as arguments.
#   . apps/install.sh; td_install "$TD_BUILD_PACKAGES"

TD_BUILD_PACKAGES="gcc g++ cmake ninja-build ccache pkg-config libopencv-dev libvisp-dev libceres-dev liblapacke-dev
    libopenblas-dev libyaml-dev libjansson-dev libpng-dev zlib1g-dev libjpeg-dev libssl-dev libapriltag-dev libopencv-contrib-dev
    libcairo2-dev libsundials-dev libxml2-dev liburdfdom-dev libzip-dev libwebsockets-dev libgdal-dev libcgal-dev
    libopenmpi-dev openmpi-bin"
TD_DATA_PACKAGES="opencv-doc visp-images-data"

td_install() {
    missing=
    for package in $1; do
        dpkg-query -W -f '${Status}\n' "$package" 2>/dev/null | grep -q '^install ok installed' || missing="$missing $package"
    done
    if [ -n "$missing" ]; then
        echo "== installing packages:$missing"
        if [ "$(id -u)" -eq 0 ]; then as_root=; else as_root=sudo; fi
        $as_root apt-get update -q
        # Slim images of Debian drop documentation; data sets live there.
        $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --no-install-recommends \
            -o Dpkg::Options::="--path-include=/usr/share/doc/opencv-doc/*" \
            -o Dpkg::Options::="--path-include=/usr/share/doc/dart/*" $missing
    fi
}

# A package that was installed while documentation was dropped has no data: install it again.
td_install_data() {
    td_install "$TD_DATA_PACKAGES"
    if [ ! -e /usr/share/doc/opencv-doc/examples/data/left01.jpg ]; then
        if [ "$(id -u)" -eq 0 ]; then as_root=; else as_root=sudo; fi
        $as_root env DEBIAN_FRONTEND=noninteractive apt-get install -y -q --reinstall --no-install-recommends \
            -o Dpkg::Options::="--path-include=/usr/share/doc/opencv-doc/*" opencv-doc
    fi
}
