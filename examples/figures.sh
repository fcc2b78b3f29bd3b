#!/bin/sh
# The figures of the paper, with surflux on the path: sh examples/figures.sh FOLDER [PIXELS]
set -e
here=$(dirname "$0")
to=${1:?folder}
size=${2:-256}

figure() {
    name=$1 scene=$2
    shift 2
    surflux render "$here/$scene.usda" -o "$to/$name.exr" --image-width "$size" --tolerance 0.005 --preview "$@"
}

figure box teapots --aov color                                    # figures 2, 3
figure area_lights teapots_lights --aov color                     # figure 10
figure environment teapots_sky --aov color                        # figure 11
figure bounces_0 teapots --aov color --bounces 0                  # figure 12
figure bounces_1 teapots --aov color --bounces 1
figure bounces_2 teapots --aov color --bounces 2
figure occlusion teapots --aov visibility                         # figure 14
figure reflection_occlusion teapots --aov reflection_occlusion
