function __teleop_complete
    set -l words (commandline -opc)
    set -l word (commandline -ct)
    set -l rest (string replace -r '^.*[=,]' '' -- $word)
    set -l ahead (string sub -l (math (string length -- "$word") - (string length -- "$rest")) -- $word)
    for line in (sh -c $__teleop_core'_teleop_complete "$@"' sh "$word" $words[2..])
        switch $line
            case \tfolders\*
                printf '%s\n' $ahead(__fish_complete_directories "$rest" '')
            case \tfiles\*
                set -l found $rest*/ $rest*.py
                string match -q '*\**' -- $line; and not string match -q '*.py' -- $line; and set found $rest*
                test -z "$found"; or printf '%s\n' "$ahead"$found
            case '*'
                printf '%s\n' $line
        end
    end
end
complete -c teleop -f -a '(__teleop_complete)'
