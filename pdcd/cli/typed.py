"""The command line as a table: every command, and below it a line for each of its options.

The line of a command has its words, the "module:function" below `pdcd.cli` that runs it (`-` for
one that needs another word), and what it does. The line of an option has its names, words that
stand for its values (the first says their type), an optional default after `=`, and its purpose.
The line of an argument begins with its name in the namespace; an option may have such a name after
`>`. `[ ]` may be left out, `...` may be repeated, `{ }` lists the choices, `!` must be given. `@`
stands for lines that several commands share, or for fields of a request. Two or more spaces
separate columns; a line with a larger indent continues the text before it. `pdcd.cli.parser` reads
the table.
"""

from __future__ import annotations

WHEN = "a date (2026-01-31, 2026-01-31T12:00), or how long ago: 30m, 12h, 7d, 2w"

COMMANDS = """
serve  serve:serve  run the daemon, by default in the foreground
  @config
  --socket PATH               listen here
  --state-dir DIR             keep runs below this folder
  --background                return once the daemon listens, and leave it running; its log is
                              daemon.log in the state folder
  -v --verbose                log everything, not only warnings, also at a terminal
capture  capture:capture  take a photo and wait for it
  usage                       [OPTIONS] GOAL
  @photo
  @detach
  @queue
transport  capture:capture  photograph entries of the transport matrix
  usage                       [OPTIONS] [--rows R [R2]]
  @photo goal=transport without=method
  @detach
  @queue
batch  batch:take_batch  take all photos that a table lists, and retry those that fail
  more                        Take all photos that a table lists, one after the other, and retry
                              those that fail. Photos that are done are not taken again: the same
                              command resumes where it was interrupted. A TOML file has a [[photo]]
                              for each, and [all] for what they share; a CSV file has a line for
                              each.
  table FILE                  a .toml or .csv file with the goal and the options of each photo
  --out DIR                   folder of the runs (or links to them), table.csv and summary.txt;
                              default: the table's name
  --retries N=1               how often a failed photo is tried again
  --pause S=30.0              seconds to wait before a photo is tried again
  --workers N                 photos to take at a time; only with --local on the mock bench
  @client
  @local
compare  compare:compare  take a photo by every method, side by side
  usage                       [OPTIONS] GOAL
  @photo without=method
init  init:prepare_bench  find out what this machine has, and write the files of a bench
  --yes                       ask nothing: accept every proposal
  --out DIR                   folder to write into; default: where pdcd looks for pdcd.toml
  --display :N                X server to look at; default: $DISPLAY
  --projector OUTPUT          name of the output that drives the projector
  --mask OUTPUT               name of the output that drives the mask
  --camera KEY                a camera that was found, or virtual, or none
  --release PORT              serial port that opens the shutter, or camera if that opens it
demo  demo:run_demo  start a daemon on the mock bench and take one photo with it
  --out DIR=demo              folder of the state and the runs
  @fields codes seed
plan  capture:plan  say what a capture would do, without doing it
  usage                       [OPTIONS] GOAL
  @photo without=out
  @queue

status  jobs:show_status  say what the daemon is doing
  @client
watch  jobs:watch  follow a job to its end, or all jobs until interrupted
  job [JOB]
  @client
cancel  jobs:cancel  end a job: the one named, else the running one
  job [JOB]
  @client
wait  capture:wait  wait for a job and report it as capture does
  job JOB
  @client
web  web:serve_web  serve a page for the person at the bench, on this machine only
  @config
  @socket
  --state-dir DIR             where the daemon keeps its runs
  --host ADDRESS=127.0.0.1    an address of the loopback interface
  --port N=8137               port; 0 takes a free one

drivers  tools:print_drivers  list drivers and why some are unavailable
  @json
doctor  -  check the devices of the bench, and say how to mend them
doctor display  doctor:diagnose_display  look at the X server and at both panels
  @device
  --display :N                X server; default: the configuration's
doctor camera  doctor:diagnose_camera  look at the camera on USB or network; nothing is exposed
  @device
  --raw FILE                  a RAW photo of this camera, to read frame and orientation from
doctor trigger  doctor:diagnose_trigger  look at the shutter, and click it if asked to
  @device
  --click                     open the shutter, and close it again
  --seconds S=1.0             how long to hold it open
doctor bench  doctor:diagnose_bench  run the acceptance checks of a bench in front of a white card
  @device
  --page FILE                 write them as a page to print
  --out DIR                   folder for its two runs
calibrate  calibrate:calibrate  measure the bench with its own camera
  usage                       [OPTIONS] [STEP ...]
  usage                       list | use NAME|none|latest | forget NAME [--yes]
  step [STEP ...]             steps to take, of <steps>; default: all that a bench needs. Instead of
                              steps: list shows the stored calibrations, use selects one for
                              captures, by its name, or the latest, forget removes one
  --scene                     calibrate on the scene in front of the camera, without a card
  @fields marks
  --anew                      measure all steps, also those that a recently interrupted calibration
                              has finished
  --again FOLDER              compute a calibration again from its photos
  --out DIR                   make the folder in DIR; only with --local
  --yes                       ask nothing: the card is in its place; forget without asking
  @queue
  @local
  @client
show  panels:show_pattern  show a pattern on both panels, without a camera
  pattern [PATTERN]=grid      one of <patterns>
  --index N=0                 number of the code
  --loop                      show all codes over and over, to look through the mask
  --out PNG                   on the mock bench: file to draw into; default: show-PATTERN.png
  --seconds S                 end after S seconds
  --detach                    leave it on the daemon's panels and return
  @client
preview  preview:show_live_view  show live what the camera sees, and its focus
  pattern [STILL]=white       pattern that both panels show, one of <still>
  --index N=0                 number of the code
  --seconds S                 end after S seconds; without it, by Ctrl-C
  --out PNG                   file to keep the last picture in
  --web                       show it on the page of pdcd web, in a browser
  --port N=8137               port of that page; 0 takes a free one
  @client
stream  stream:show_stream  take photos again and again by one plan, until Ctrl-C
  usage                       [OPTIONS] GOAL
  more                        Take photos again and again by one plan, until Ctrl-C, and say how
                              good the newest picture is. Each photo takes the codes of the next
                              part of a set; --codes are those of one photo.
  @photo without=error,confidence,seconds,until_error,repeat,method,keep_raw,out
  @queue
  --over N=1                  how many of the newest photos make a picture
  --rate HZ                   pictures a second at most; default: 30
  --seconds S > lasts_s       end after S seconds
  --out PATH > kept_in        keep the pictures: in a video (.mp4), or as float TIFFs in a folder
  --record                    at the end, make a run folder of the newest set of photos
timing  panels:measure_timing  measure how regularly the panels show codes
  --frames N=3000             refreshes to show
  --out PNG                   write histograms of the times
  --config FILE               configuration that names the panels
  @json
config  tools:examine_config  check the configuration without a device, print it or its schema
  action {check,show,schema}
  --config FILE               file to take instead of the usual one
virtual-camera  tools:run_virtual_camera  act as a Canon EOS 450D on the network
  --port N=15740              port; 0 takes a free one
  --scene KIND=chart          a scene of the mock bench
  --small                     send small files, of 192 x 128 samples
snr  snr:print_snr  compare one coded photo with many photos without a mask
  --profile NAME=modern       sensor: a name or the path of a .toml file
  --iso N                     ISO of the coded photo; default: the profile's lowest
  --codes N=512               codes as the paper counts them, four to a code pair, each a mask-less
                              photo
  --exposure S=30.0           seconds of the coded photo, and of all others together
  --signal E                  electrons of the coded photo through an ideal mask; default: 13 % of
                              the highest
  --transmission SHARE=1.0    light that the open mask lets through, as a share of 1 or in %
  @json

runs  runs:print_runs  list, show, export, verify or remove runs on disk
  usage                       [OPTIONS] [show|export|verify|prune]
  @runs
  @filters of=list
  --all > list_all            every run on disk, and the quick looks of previews; default: the
                              newest 50 captures
runs show  runs:show_run  show everything that is known of a run
  @run
  @again
runs export  runs:export_run  write pictures of a run for other programs
  @run
  @export
  @again
runs verify  runs:verify  say whether runs are whole and unchanged
  run_name [RUN ...]          job, name or folder; default: all finished runs
  @filters
  @again
runs prune  runs:prune  remove runs that are no longer wanted
  more                        Remove captures, after saying which. Name at least one of
                              --older-than, --failed and --keep; a capture goes if it meets all
                              that you name.
  @filters
  --older-than T              started before that: <when>
  --keep N                    keep the newest N of those chosen, of any age
  --dry-run                   only say what would be removed
  --yes                       do not ask
  @again
decode  tools:decode  decode a run folder again from its RAW files
  folder FOLDER
  --partial                   decode a run that was interrupted, into a new folder
  --out DIR                   where to make that folder; default: beside the old one
  @json
verify  verify:verify_runs  say whether runs are whole and unchanged
  folder FOLDER ...
  --manifest-sha256 HEX       digest that the capture printed, which also shows changes made on
                              purpose
  @json
export  export:export  write pictures of a finished run for other programs
  folder FOLDER
  @export
  @json
report  report:report  write a page of a finished run, with its pictures
  folder FOLDER
  --out FILE                  file to write; default: report.html in the run's folder
  @json
row  row:draw_matrix_row  show which paths a finished run kept for one cell
  folder FOLDER
  --cell ROW COLUMN !         the cell, counted from 0
  --photo NAME                name of a photo; default: the one that the answer rests on
  --out PNG                   file to write; default: row-PHOTO-ROW-COLUMN.png in FOLDER
  @json
figures  figures:take_figures  repeat the paper's experiments, and make one page of them
  number [NUMBER ...]         such as 1, 12, table-1, appendix; default: all
  --out DIR !                 folder of the page
  --quick                     a coarser camera and fewer codes, some two minutes on two cores (the
                              default)
  --full                      the camera's own resolution, the paper's codes; hours
  --profile NAME=450d         sensor profile of the camera; mono has no colours
  --no-plots > plots          leave out plots, which need matplotlib
  --workers N                 processes; default: 2
  @json

version  shell:print_version  print the version
completion  shell:print_completion  print a script that completes commands
  more                        Print a script by which a shell completes commands, options and files.
                              For bash into ~/.local/share/bash-completion/completions/pdcd, for zsh
                              into _pdcd in a folder of $fpath, for fish into
                              ~/.config/fish/completions/pdcd.fish.
  shell {bash,zsh,fish}
man  shell:print_manual  print the manual page
"""

SHARED = """
config
  --config FILE               configuration; default: the mock bench
socket
  --socket PATH               where the daemon listens
json
  --json                      print JSON, one object a line
client
  @config
  @socket
  @json
device
  --config FILE               configuration that names the device
  @json
local
  --local                     drive the rig from this process, without a daemon
queue
  --queue                     wait while others use the rig
detach
  --detach                    start only; the job outlives this command
run
  run_name RUN                its job, its name or its folder
runs
  @config
  --socket PATH               ask the daemon that listens there
  @json
  --state-dir DIR             look below this folder; default: where the daemon has its runs, else
                              where captures without a daemon go
filters
  --goal GOAL                 only runs of this goal
  --since T                   started then or later: <when>
  --tag WORD ... > tags       only runs with this tag; repeat it for runs that have several
  --failed                    only captures without a whole run; of prune: without a manifest
export
  --format {exr,tiff16,png16,npz} !  32-bit floats (exr, npz), or 16 bits a colour, linear
  --picture NAME ...          name of a picture; repeat it for more; default: all
  --out DIR=.                 folder to write into, not that of a run
  --upright                   as the projector sees the scene, cropped to the field; default: as the
                              camera does
  --white-patch X Y           make what lies at X Y of the field grey, from 0 0 at its upper left
                              corner to 1 1; default: colours as taken
  --range BLACK WHITE         scene units that become 0 and 65535 in 16 bits; default: 0 and a power
                              of two
  --force                     replace files that are there
"""


def parse_share(text: str) -> float:
    """Read "1%" or "0.01"; argparse reports the ValueError of anything else."""
    number = text.removesuffix("%")
    return float(number) / (100.0 if number != text else 1.0)
